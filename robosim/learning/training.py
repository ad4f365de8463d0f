"""A training run from its first decision to its last: stages, and the moments that it can be resumed from."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robosim.arena import load_arena
from robosim.control.card import StageCard
from robosim.control.learned import check_fit
from robosim.control.policy import Policy, load_policy
from robosim.discretise.observation import gain_columns
from robosim.envs.vector import Snapshot, VectorEnv
from robosim.errors import InputError
from robosim.learning.checkpoint import Checkpoint, read_part, write_checkpoint, write_part
from robosim.learning.config import TrainConfig
from robosim.learning.curriculum import Ending, Stage, is_steady, plan_stages, stage_budget
from robosim.learning.dqn import DqnSettings, StackedDoubleDQN
from robosim.learning.loop import FrozenTeam, StageLoop, Weights
from robosim.learning.metrics import Metrics, MetricsLog, Sums
from robosim.learning.networks import NetworkShape
from robosim.learning.technique import Technique, find_technique

EVALUATION_SEED = 2
"""Child of the run's root seed; 0 and 1 serve the first stage, and later ones take two each."""


class Training:
    """Everything that changes while a team learns."""

    def __init__(self, config: TrainConfig) -> None:
        """Read the arena and the policy to start from, if any; InputError when something does not fit."""
        self.config = config
        self.log = MetricsLog()
        self.step = 0
        """Joint decisions of the run so far."""
        self.ended: list[StageCard] = []
        """The stages that are over."""
        before = load_policy(config.start_from) if config.start_from else None
        self.technique = technique_of(config, before)
        """What the run learns by; it has the layers and the mask of the policy that it starts from."""
        self._team = starting_team(config, before) if before else {}
        """Weights of the robots that have learned in earlier stages."""
        shared = self.technique.parameter_sharing
        self.stages = plan_stages(
            config, config.robots if shared and self._team else count_robots(self._team)
        )
        self._saved: list[tuple[int, int, str]] = []
        """Parts of the present stage's experience that are on disk: first transition, last + 1, file."""
        self._begin(0)

    @property
    def finished(self) -> bool:
        """Whether all stages are over."""
        return len(self.ended) == len(self.stages)

    @property
    def stage(self) -> Stage:
        """The present stage, or the last when all are over."""
        return self.stages[min(len(self.ended), len(self.stages) - 1)]

    def advance(self, beside: Executor | None = None) -> Metrics | None:
        """Take one decision in every environment; returns the row of the metrics that it closes, if any.

        `beside` is explained in `StageLoop.advance`.
        """
        loop = self.loop
        row = loop.advance(beside)
        self.step += self.env.num_envs
        if row is None:
            return None
        rows = [one for one in self.log.rows if one.stage == self.stage.name]
        if loop.finished:
            self._end("budget")
        elif is_steady(rows, loop.budget, self.config.steady_gain):
            self._end("steady")
        return row

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Return the parameters of all robots so far, those that learn at present last."""
        if self.finished or (self._team and not self.loop.step):
            return dict(self._team)
        return joined(self._team if self.stage.frozen else {}, self.learner.parameters.to_numpy())

    def _end(self, ending: Ending) -> None:
        stage = self.stage
        self._team = self.weights()
        self.ended.append(
            StageCard(
                name=stage.name,
                robots=stage.robots,
                learning=stage.learning,
                steps=self.loop.step,
                ended=ending,
            )
        )
        if not self.finished:
            self._begin(len(self.ended))

    def _begin(self, number: int) -> None:
        stage, config = self.stages[number], self.config
        learner_seed, env_seed = 2 * number + (number > 0), 2 * number + 1 + (number > 0)
        budget = stage_budget(self.stages, number, max(1, config.steps - self.step))
        self.env = make_env(config, config.num_envs, self.seed(env_seed), robots=stage.robots)
        seed = np.random.SeedSequence(config.seed, spawn_key=(learner_seed,))
        self.learner = make_learner(config, stage.learning, self.env, seed, budget, self.technique)
        frozen = None
        if stage.frozen:
            shape = replace(self.learner.shape, robots=stage.frozen)
            frozen = FrozenTeam(shape, self._team, self.learner.settings.progress)
            if not stage.explores:
                # A newcomer that copies takes after the robot before it.
                self.learner.load_parameters(robots_of(self._team, stage.frozen - 1, stage.frozen))
        elif self._team:
            self.learner.load_parameters(self._team)
        self._saved = []
        self.log.begin_stage()
        self.loop = StageLoop(config, stage, budget, self.env, self.learner, frozen, self.log)

    def seed(self, child: int) -> int:
        """Return a number drawn from a child of the run's root seed."""
        return int(np.random.SeedSequence(self.config.seed, spawn_key=(child,)).generate_state(1)[0])

    def save(self, folder: Path, wall_time: float) -> None:
        """Write a checkpoint, `wall_time` (s) into the run.

        InputError, and the one before untouched, when it cannot be written.
        """
        tensors: dict[str, torch.Tensor] = {f"team.{n}": torch.from_numpy(a) for n, a in self._team.items()}
        facts: dict[str, Any] = {
            "ended": [stage.model_dump() for stage in self.ended],
            "sums": asdict(self.log.sums),
            "rows": [asdict(row) for row in self.log.rows],
            "wall_time": wall_time,
        }
        if not self.finished:
            snapshot = self.env.snapshot()
            self._save_experience(folder)
            tensors |= self.loop.state()
            tensors["actions"] = torch.from_numpy(snapshot.actions)
            facts |= {
                "loop": self.loop.counters(),
                "seeds": snapshot.seeds,
                "episode": snapshot.episode,
                "experience": self._saved,
            }
        write_checkpoint(folder, Checkpoint(self.step, tensors, facts, tuple(n for _, _, n in self._saved)))

    def _save_experience(self, folder: Path) -> None:
        """Write what has been added since the checkpoint before, and forget what the replay has dropped."""
        replay, number = self.learner.replay, len(self.ended)
        oldest = replay.added - replay.length
        saved = [part for part in self._saved if part[1] > oldest]
        first = max(saved[-1][1] if saved else 0, oldest)
        if first < replay.added:
            name = f"experience-{number:04d}-{first:012d}-{replay.added:012d}.zst"
            write_part(folder, name, replay.export(first, replay.added))
            saved.append((first, replay.added, name))
        self._saved = saved

    def restore(self, checkpoint: Checkpoint, folder: Path) -> None:
        """Go back to a checkpoint that a run of the same configuration wrote.

        InputError when it, or a part of its experience in `folder`, is damaged or of another run.
        """
        try:
            self._restore(checkpoint.tensors, checkpoint.facts, folder)
        except InputError:
            raise
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise InputError(f"the checkpoint is not one of this run ({error!r}).") from error
        self.step = checkpoint.step

    def _restore(self, tensors: Mapping[str, torch.Tensor], facts: Mapping[str, Any], folder: Path) -> None:
        self.ended = [StageCard.model_validate(stage) for stage in facts["ended"]]
        team = {n.removeprefix("team."): t.numpy() for n, t in tensors.items() if n.startswith("team.")}
        self._team = team
        self.log.rows[:] = [Metrics(**row) for row in facts["rows"]]
        if not self.finished:
            # The stage began when the run had taken this many decisions; its budget depends on that.
            self.step = sum(stage.steps for stage in self.ended)
            self._begin(len(self.ended))
            seeds, episode = tuple(map(int, facts["seeds"])), int(facts["episode"])
            snapshot = Snapshot(seeds, episode, tensors["actions"].numpy())
            self.loop.restore(tensors, facts["loop"], self.env.restore(snapshot))
            self._saved = [(int(first), int(last), str(name)) for first, last, name in facts["experience"]]
            if self._saved:
                parts = (read_part(folder, name) for _, _, name in self._saved)
                self.learner.replay.restore(self._saved[0][0], parts)
        self.log.sums = Sums(**facts["sums"])


def technique_of(config: TrainConfig, before: Policy | None) -> Technique:
    """Return the technique of a run: that of its name, with what the policy that it starts from needs to act.

    Networks that learned with normalised layers or behind a mask know nothing of acting without.
    """
    technique = find_technique(config.technique)
    if before is None:
        return technique
    needs = before.card.network
    return replace(technique, normalised=needs.normalisation == "rms", action_mask=needs.mask)


def starting_team(config: TrainConfig, policy: Policy) -> Weights:
    """Return the weights of the policy that a run starts from; InputError when they do not fit the run."""
    robots, network = policy.card.robots, policy.card.network
    if (network.input, network.activation, network.output) != ("own", "relu", "action values"):
        raise InputError(
            f"start_from {config.start_from!r} has networks with {network.input} input, {network.activation} "
            f"and {network.output}: a run starts from ones with own input, relu and action values."
        )
    if network.hidden != config.hidden:
        raise InputError(
            f"start_from {config.start_from!r} has hidden layers {list(network.hidden)}: "
            f"the run's must be the same, not {list(config.hidden)}."
        )
    if robots <= config.robots or network.shared:
        check_fit(policy, make_env(config, 1, 0, robots=min(robots, config.robots)), config.start_from)
    if not find_technique(config.technique).parameter_sharing:
        return {name: array[list(network.of_robot)] for name, array in policy.weights().items()}
    if not network.shared:
        raise InputError(
            f"start_from {config.start_from!r} has a network for each robot: technique {config.technique} "
            "starts from one that all robots share."
        )
    return policy.weights()


def robots_of(weights: Weights, first: int, last: int) -> dict[str, NDArray[np.float32]]:
    """Return the weights of robots `first` to `last - 1`."""
    return {name: array[first:last] for name, array in weights.items()}


def joined(before: Weights, after: Weights) -> dict[str, NDArray[np.float32]]:
    """Return the weights of two teams as those of one."""
    if not before:
        return dict(after)
    return {name: np.concatenate((before[name], array)) for name, array in after.items()}


def count_robots(weights: Weights) -> int:
    """Return how many robots the weights are for."""
    return len(weights["layer0.weight"]) if weights else 0


def make_env(
    config: TrainConfig, num_envs: int, seed: int, robots: int | None = None, steps: int | None = None
) -> VectorEnv:
    """Return the environments that a configuration asks for.

    `robots` and `steps` replace its team and its length of an episode, where 0 is the arena's own; with
    `steps`, which is not for training, pellets lie evenly.
    """
    technique = find_technique(config.technique)
    return VectorEnv(
        load_arena(config.arena),
        robots=config.robots if robots is None else robots,
        num_envs=num_envs,
        seed=seed,
        actions=config.actions,
        encoding=config.encoding,
        stigmergy=technique.stigmergy,
        reward="global" if technique.global_reward else "local",
        sharing=config.sharing,
        signed_distance=technique.signed_distance,
        idle_cost=technique.idle_cost,
        pellet_gradient=config.pellet_gradient if steps is None else 0.0,
        episode_steps=(config.episode_steps if steps is None else steps) or None,
        pheromone=config.pheromone(),
    )


def make_learner(
    config: TrainConfig,
    robots: int,
    env: VectorEnv,
    seed: np.random.SeedSequence,
    steps: int,
    technique: Technique | None = None,
) -> StackedDoubleDQN:
    """Return a fresh learner for `robots` robots; InputError when its replay exceeds the memory.

    `steps` is how many joint decisions it will learn from at most; `technique` is the configuration's where
    none is given.
    """
    technique, layout = technique or find_technique(config.technique), env.layout
    # One network for all learns from as many transitions as their own networks would together.
    networks, each = (1, robots) if technique.parameter_sharing else (robots, 1)
    shape = NetworkShape(networks, layout.size, config.hidden, env.num_actions, technique.normalised)
    # More room than there are decisions would be reserved in vain.
    capacity = max(min(config.replay_capacity, steps + config.num_envs), config.num_envs)
    settings = DqnSettings(
        discount=config.discount**config.return_steps,
        batch_size=config.batch_size * each,
        target_interval=config.target_interval,
        replay_capacity=capacity * each,
        reward_scale=config.reward_scale,
        progress=gain_columns(layout.names, config.actions) if technique.action_mask else None,
    )
    try:
        return StackedDoubleDQN(shape, settings, seed, config.device, config.precision)
    except (RuntimeError, MemoryError) as error:
        raise InputError(
            f"replay_capacity is {config.replay_capacity}: {robots} robots with observations of "
            f"{env.layout.size} numbers need more memory than there is."
        ) from error
