"""A training run: experience in, updates, and the run folder that is left behind."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

import robosim
from robosim.arena import load_arena
from robosim.arena.schema import RobotSection, TimingSection
from robosim.control.card import (
    Evaluation,
    NetworkCard,
    ObservationCard,
    PolicyCard,
    TechniqueCard,
    TrainingCard,
    arena_card,
)
from robosim.control.evaluate import evaluate
from robosim.control.learned import LearnedController
from robosim.control.policy import RUN_POLICY, Policy, save_policy
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.files import write_whole
from robosim.learning.config import TrainConfig, write_config
from robosim.learning.dqn import DqnSettings, StackedDoubleDQN
from robosim.learning.metrics import Metrics, MetricsLog, write_metrics
from robosim.learning.networks import NetworkShape
from robosim.learning.returns import Experience, MultiStepReturns
from robosim.learning.technique import find_technique

CONFIG_FILE = "config.toml"
METRICS_FILE = "metrics.parquet"
EVALUATION_FILE = "evaluation.json"

_ROW = 500
"""Joint decisions in a row of the metrics."""

Report = Callable[[Metrics], None]


@dataclass(frozen=True, slots=True)
class TrainResult:
    """What a finished run leaves."""

    folder: Path
    wall_time: float
    """Time spent learning, s."""
    evaluation: Evaluation | None


def train(config: TrainConfig, folder: Path, report: Report, command: str = "") -> TrainResult:
    """Learn, evaluate and fill `folder`: config.toml, metrics.parquet, policy/ and evaluation.json.

    Interrupted (KeyboardInterrupt), it saves metrics and the policy learned so far, without an evaluation,
    and lets the interrupt pass. InputError for a folder that is in use or cannot be written, before learning.
    """
    seeds = _Seeds.of(config)
    env = make_env(config, config.num_envs, seeds.env)
    learner = make_learner(config, env, seeds.learner)
    prepare_folder(folder)
    write_config(config, folder / CONFIG_FILE)
    log = MetricsLog()
    start = time.perf_counter()
    try:
        learn(config, env, learner, log, report)
    finally:
        wall_time = time.perf_counter() - start
        if log.rows:
            write_metrics(log.rows, folder / METRICS_FILE)
        weights = learner.parameters.to_numpy()
        steps = log.rows[-1].step if log.rows else 0
        card = make_card(config, env, TrainingCard(
            command=command, seed=config.seed, steps=steps, wall_time=wall_time, versions=_versions(),
        ))  # fmt: skip
        save_policy(folder / RUN_POLICY, weights, card)
    if config.evaluation_episodes == 0:
        return TrainResult(folder, wall_time, None)
    controller = LearnedController(Policy(weights, card), str(folder))
    whole = replace(config, episode_steps=config.evaluation_steps)
    test = make_env(whole, config.evaluation_episodes, seeds.evaluation)
    evaluation = evaluate(controller, test, config.evaluation_episodes, seeds.evaluation)
    write_whole(folder / EVALUATION_FILE, evaluation.model_dump_json(indent=2) + "\n")
    save_policy(folder / RUN_POLICY, weights, card.model_copy(update={"evaluation": evaluation}))
    return TrainResult(folder, wall_time, evaluation)


def learn(
    config: TrainConfig, env: VectorEnv, learner: StackedDoubleDQN, log: MetricsLog, report: Report
) -> None:
    """Let `learner` act in `env` and learn from it for `config.steps` joint decisions."""
    returns = MultiStepReturns(config.return_steps, config.discount)
    observation = env.reset()
    step = 0
    while step < config.steps:
        actions = learner.act(observation, config.epsilons(step)[:, None])
        transition = env.step(actions)
        decision = Experience(observation, actions, transition.reward, transition.final_observation)
        complete = returns.add(decision, bool(transition.truncated.all()))
        if complete is not None:
            learner.replay.add(*complete)
        observation = transition.observation
        log.add(transition.reward, transition.final_delivered, transition.truncated)
        rows_before, step = step // _ROW, step + env.num_envs
        due = int(max(0, step - config.warmup) * config.updates_per_step)
        while learner.updates < due:
            learner.update(config.learning_rate_at(step))
        if step // _ROW > rows_before or step >= config.steps:
            report(log.cut(config.epsilon(step), float(learner.loss().mean())))


def make_env(config: TrainConfig, num_envs: int, seed: int) -> VectorEnv:
    """Return the environments that a configuration asks for."""
    technique = find_technique(config.technique)
    return VectorEnv(
        load_arena(config.arena),
        robots=config.robots,
        num_envs=num_envs,
        seed=seed,
        actions=config.actions,
        encoding=config.encoding,
        stigmergy=technique.stigmergy,
        reward="global" if technique.global_reward else "local",
        episode_steps=config.episode_steps or None,
    )


def make_learner(config: TrainConfig, env: VectorEnv, seed: np.random.SeedSequence) -> StackedDoubleDQN:
    """Return a fresh learner for an environment; InputError when its replay exceeds the memory."""
    shape = NetworkShape(config.robots, env.layout.size, config.hidden, env.num_actions)
    # More room than the run has decisions would be reserved in vain.
    capacity = min(config.replay_capacity, config.steps + config.num_envs)
    settings = DqnSettings(
        discount=config.discount**config.return_steps,
        batch_size=config.batch_size,
        target_interval=config.target_interval,
        replay_capacity=max(capacity, config.num_envs),
        reward_scale=config.reward_scale,
    )
    try:
        return StackedDoubleDQN(shape, settings, seed)
    except (RuntimeError, MemoryError) as error:
        raise InputError(
            f"replay_capacity is {config.replay_capacity}: {config.robots} robots with observations of "
            f"{env.layout.size} numbers need more memory than there is."
        ) from error


def prepare_folder(folder: Path) -> None:
    """Make the run folder; InputError if there is something in it, or it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise InputError(f"{folder}: this folder is not empty; a run needs a new one.")
        probe = folder / CONFIG_FILE
        probe.touch()
    except FileExistsError:
        raise InputError(f"{folder}: this is a file; a run needs a folder.") from None
    except OSError as error:
        raise InputError(f"{folder}: the run folder cannot be written: {error.strerror or error}.") from None


def make_card(config: TrainConfig, env: VectorEnv, training: TrainingCard) -> PolicyCard:
    """Return the card of the policy that a run has learned."""
    technique = find_technique(config.technique)
    layout = env.layout
    return PolicyCard(
        robots=config.robots,
        technique=TechniqueCard(**asdict(technique)),
        arena=arena_card(env.arena),
        observation=ObservationCard(
            encoding=layout.encoding, stigmergy=layout.stigmergy, names=tuple(layout.names)
        ),
        actions=layout.actions,
        num_actions=env.num_actions,
        network=NetworkCard(hidden=config.hidden),
        robot=RobotSection(**asdict(env.arena.robot)),
        timing=TimingSection(**asdict(env.arena.timing)),
        training=training,
    )


@dataclass(frozen=True, slots=True)
class _Seeds:
    learner: np.random.SeedSequence
    env: int
    evaluation: int

    @classmethod
    def of(cls, config: TrainConfig) -> _Seeds:
        learner, env, evaluation = np.random.SeedSequence(config.seed).spawn(3)
        return cls(learner, int(env.generate_state(1)[0]), int(evaluation.generate_state(1)[0]))


def _versions() -> dict[str, str]:
    return {
        "robosim": robosim.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": torch.__version__,
    }
