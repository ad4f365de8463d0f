"""The job of a sweep: a team learns, then it is measured; or a team that there is already is measured."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field

from robosim.analysis.measure.monitor import TeamMonitor
from robosim.arena import arena_names, load_arena
from robosim.control.card import PolicyCard
from robosim.control.controller import SCRIPTED, Controller, make_controller
from robosim.control.evaluate import evaluate
from robosim.control.learned import LearnedController
from robosim.control.network import DRAWING
from robosim.control.policy import RUN_POLICY, find_policy, read_policy, team_digest
from robosim.envs.config import MOST_STEPS, EnvConfig
from robosim.envs.mixed import MixedVectorEnv
from robosim.envs.profile import LONGEST_PROFILE, profile_text
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError, refused, shown
from robosim.experiments.jobs import Job, Outcome, Report, ignore
from robosim.experiments.measures import evaluation_figures, evaluation_series, learning_curve
from robosim.learning.config import EVALUATION_SEED, RunConfig, child_seed
from robosim.learning.curriculum import plan_stages
from robosim.learning.devices import require_device_name
from robosim.plugins import load_plugins
from robosim.records import Record

POLICY = "policy:"
"""In front of a trained policy's name or folder where a technique's name could stand."""
_SIDE_BY_SIDE = 16
"""Episodes that run at once."""
_RUN = "run"
_DEVICE = "device"
_COUNTING = ("technique", "seed", *DRAWING)
_WEIGHTS = "weights"
_START_WEIGHTS = "start_weights"
_FREE = ("world", "arena", "robots", "reward", "pellet_gradient", "episode_steps", "profile")
"""Fields of the environment on which no finished policy depends: of the task, and of training alone."""


class Measuring(Record):
    """How a team is measured: whole episodes without exploration."""

    episodes: int = Field(default=5, ge=1, le=1000)
    """How many."""
    steps: int = Field(default=0, ge=0, le=MOST_STEPS)
    """Decisions in each of them; 0 for as many as the arena says."""
    profile: str | None = Field(default=None, max_length=LONGEST_PROFILE)
    """What is random and wrong about robots then, by name, path or text of a profile; none for nothing."""


def learning_job(run: RunConfig, measuring: Measuring) -> Job:
    """Return the job of a team that learns as `run` says and is then measured.

    Of the run's settings only these count: technique, seed, and the temperatures at which the team draws its
    actions, if it does. The others change neither what is learned nor what the team does. A policy to start
    from counts by its weights; InputError when there is none.
    """
    table = run.model_dump(mode="json", exclude_none=True)
    settings = {name: table["run"][name] for name in _COUNTING if name in table["run"]}
    config = table | {"run": settings, "evaluation": _evaluation(measuring)}
    if run.schedule.start_from:
        config[_START_WEIGHTS] = start_weights(run.schedule.start_from)
    return Job(config)


def start_weights(start_from: str) -> str:
    """Return by what a job knows the policy that its training starts from; InputError when there is none."""
    try:
        return _known_weights(start_from)
    except InputError as error:
        raise InputError(f"start_from: {error}") from None


def measuring_job(team: str, env: EnvConfig, seed: int, measuring: Measuring) -> Job:
    """Return the job that measures a scripted controller, or a policy by `policy:NAME`, in an environment.

    InputError when there is no such team.
    """
    # What only training asks for must not tell jobs from one another.
    plain = _table(env.changed(pellet_gradient=0.0, episode_steps=0, profile=None))
    config: dict[str, Any] = {
        "env": plain,
        "run": {"technique": team, "seed": seed},
        "evaluation": _evaluation(measuring),
    }
    if team not in SCRIPTED:
        config[_WEIGHTS] = _known_weights(team.removeprefix(POLICY))
    return Job(config)


def require_learning(run: RunConfig, measuring: Measuring) -> None:
    """Raise InputError for a team that could not begin to learn, or be measured: now, and not in its turn."""
    _measuring_env(run.env, measuring)
    # Another machine may have the device that this one lacks.
    require_device_name(getattr(run.algorithm, _DEVICE, None) or "cpu")
    if run.variety is None:
        VectorEnv(run.env, num_envs=1, seed=0)
    else:
        MixedVectorEnv(run.env, run.variety, num_envs=run.schedule.num_envs, seed=0)
    if run.schedule.start_from:
        # Only these runs need torch before their turn.
        from robosim.learning.training import starting_team

        _, team = starting_team(run, read_policy(find_policy(run.schedule.start_from)))
        plan_stages(run, team.spec.robots)


def require_driving(team: str, env: EnvConfig, measuring: Measuring) -> None:
    """Raise InputError for a scripted controller or a policy that could not be measured so."""
    one = _measuring_env(env, measuring)
    one.reset()
    make_controller(team.removeprefix(POLICY)).reset(one)


def env_of_policy(team: str, options: Mapping[str, Any]) -> EnvConfig:
    """Return the environment that a policy by `policy:NAME` learned in, with another arena, world or team.

    Of the other options, those that only training knows change nothing. InputError for one that contradicts
    what the policy was trained to see and do, and when there is no such policy.
    """
    if not team.removeprefix(POLICY):
        raise refused("technique", team, f"{POLICY} and the name or the folder of a policy")
    card = read_policy(find_policy(team.removeprefix(POLICY))).card
    _require_agreement(team, card, options)
    name, arena = card.arena.name, card.env.arena
    if name in arena_names() and load_arena(name).text == arena:
        # A record need not hold the text of what everybody has.
        arena = name
    chosen = {name: options[name] for name in ("arena", "robots", "world") if name in options}
    return card.env.with_options(**{"arena": arena, **chosen})


def _require_agreement(team: str, card: PolicyCard, options: Mapping[str, Any]) -> None:
    """Raise InputError for the first option that is not as a policy was trained."""
    of_env = EnvConfig.options()
    for name, value in options.items():
        had: Any = card.env
        if name in of_env and of_env[name].path[0] not in _FREE:
            for step in of_env[name].path:
                had = getattr(had, step)
            agrees = card.env.with_options(**{name: value}) == card.env
        elif name in DRAWING:
            had = getattr(card.network, name)
            agrees = value == had
        else:
            continue
        if not agrees:
            allowed = "absent" if had is None else shown(had)
            raise InputError(
                f"{name} is {shown(value)}, but must be {allowed}: {shown(team)} was trained so."
            )


def _known_weights(policy: str) -> str:
    """Return by what a job knows a policy that there was before; InputError unless it is whole and sound."""
    folder = find_policy(policy)
    read_policy(folder)
    return team_digest(folder)[:16]


def _require_weights(policy: str, known: str) -> None:
    """Raise InputError unless a policy is still the one that a job means."""
    if _known_weights(policy) != known:
        raise InputError(
            f"{shown(policy)} has become another policy since the sweep began: begin the sweep again."
        )


def work_off(
    config: Mapping[str, Any], folder: Path, report: Report = ignore, device: str | None = None
) -> Outcome:
    """Do the job of a configuration that `learning_job` or `measuring_job` made, in its folder.

    A training that an earlier call began goes on, to the same bits as if never interrupted, where it learned
    before. One that begins learns on `device`, if it is given and the algorithm has the option. InputError
    where a policy that the job needs is no longer the one that it was made for.
    """
    # The job may be in a process that has seen nothing of them.
    load_plugins()
    measuring = Measuring.from_table(config["evaluation"], "the job's evaluation")
    seed, team = int(config["run"]["seed"]), str(config["run"]["technique"])
    if "algorithm" not in config:
        env_config = EnvConfig.from_table(config["env"], "the job's env")
        if _WEIGHTS in config:
            _require_weights(team.removeprefix(POLICY), str(config[_WEIGHTS]))
        controller = make_controller(team.removeprefix(POLICY))
        return _measured(controller, env_config, seed, measuring, _Shares(report, 0, env_config, measuring))
    # A part that the job does not name is one that it does without.
    parts = {name: part for name, part in config.items() if name in RunConfig.model_fields}
    run = RunConfig.from_table(parts, "the job")
    if device is not None and _DEVICE in type(run.algorithm).model_fields:
        run = run.with_options(device=device)
    if _START_WEIGHTS in config:
        _require_weights(run.schedule.start_from, str(config[_START_WEIGHTS]))
    shares = _Shares(report, run.schedule.steps, run.env, measuring)
    wall_time, curve = _learn(run, folder / _RUN, shares)
    controller = LearnedController(read_policy(folder / _RUN / RUN_POLICY), str(folder / _RUN))
    outcome = _measured(controller, run.env, seed, measuring, shares)
    return replace(outcome, wall_time=wall_time, series={**outcome.series, **curve}, gpu=_gpu(folder / _RUN))


class _Shares:
    """Says which share of a job is done, by the decisions of training and evaluation; watches the latter."""

    def __init__(self, report: Report, learned: int, env: EnvConfig, measuring: Measuring) -> None:
        self._report = report
        self._learned = learned
        steps = measuring.steps or load_arena(env.arena).timing.episode_steps
        self._all = learned + measuring.episodes * steps
        self._done = self._said = 0

    def learned(self, steps: int) -> None:
        """Hear how many joint decisions the training has taken so far."""
        self._say(min(steps, self._learned))

    def begin(self, env: VectorEnv) -> None:
        """Hear that a round of episodes has begun."""
        self._done = max(self._done, self._learned)

    def step(self, env: VectorEnv) -> None:
        """Hear that a decision has been taken."""
        self._say(self._done + env.num_envs)

    def end(self, env: VectorEnv, wanted: int) -> None:
        """Hear that the round is over."""

    def _say(self, done: int) -> None:
        self._done = min(done, self._all)
        # A hundred times in all: who looks on has no more of it.
        if 100 * self._done // self._all > self._said:
            self._said = 100 * self._done // self._all
            self._report(self._done / self._all)


def _learn(run: RunConfig, folder: Path, shares: _Shares) -> tuple[float, dict[str, list[float]]]:
    """Train, or go on, or find that all is learned; return the time it took (s) and the learning curve."""
    from robosim.learning.folder import CONFIG_FILE, METRICS_FILE
    from robosim.learning.metrics import Metrics, read_metrics
    from robosim.learning.trainer import finished_result, resume, train

    def report(row: Metrics) -> None:
        shares.learned(row.step)

    result = finished_result(folder)
    if result is None and (folder / CONFIG_FILE).exists():
        result = resume(folder, report, warn=_unheard)
    if result is None:
        result = train(run.with_options(evaluation_episodes=0), folder, report)
    return result.wall_time, learning_curve(read_metrics(folder / METRICS_FILE))


def _gpu(folder: Path) -> str:
    """Return the name of the GPU on which a finished run learned; "" where it learned on the processor."""
    from robosim.learning.computing import gpu_name
    from robosim.learning.folder import RunFolder

    device = getattr(RunFolder(folder).config().algorithm, _DEVICE, None)
    return gpu_name(device or "cpu")


def _measured(
    controller: Controller, config: EnvConfig, seed: int, measuring: Measuring, shares: _Shares
) -> Outcome:
    """Run the episodes that a training's own evaluation would run, and watch them.

    All teams of the same seed begin from the same episodes, scripted ones too.
    """
    began = time.perf_counter()
    env_seed = child_seed(seed, EVALUATION_SEED)
    env = _measuring_env(config, measuring, min(measuring.episodes, _SIDE_BY_SIDE), env_seed)
    monitor = TeamMonitor()
    evaluation = evaluate(controller, env, measuring.episodes, env_seed, watch=[monitor, shares])
    return Outcome(
        figures=evaluation_figures(evaluation, monitor.episodes),
        wall_time=0.0,
        series=evaluation_series(evaluation, monitor.episodes),
        evaluation_time=time.perf_counter() - began,
    )


def _measuring_env(config: EnvConfig, measuring: Measuring, num_envs: int = 1, seed: int = 0) -> VectorEnv:
    """Return environments in which a team is measured, under the profile of measuring alone."""
    return VectorEnv(
        config.changed(profile=None),
        num_envs=num_envs,
        seed=seed,
        pellet_gradient=0.0,
        episode_steps=measuring.steps,
        profile=measuring.profile,
    )


def _unheard(_sentence: str) -> None:
    """Pass over what is said of damaged checkpoints: the run goes on from a good one."""


def _evaluation(measuring: Measuring) -> dict[str, Any]:
    """Return what a job says of how its team is measured; the file of a profile by its text."""
    if measuring.profile is not None:
        measuring = measuring.changed(profile=profile_text(measuring.profile))
    return _table(measuring)


def _table(record: Record) -> dict[str, Any]:
    return record.model_dump(mode="json", exclude_none=True)
