"""One episode recorded: of a controller as it drives, or of a trajectory as it runs again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from robosim.analysis.clogs.clog import Clog, clogs_among
from robosim.analysis.measure.monitor import EpisodeMonitor
from robosim.arena.model import Arena
from robosim.control.controller import Controller
from robosim.envs.vector import VectorEnv
from robosim.episodes.frame import Frame
from robosim.episodes.replay import begun
from robosim.episodes.trajectory import Trajectory
from robosim.playback.clogs import decisions_until_certain
from robosim.playback.recorder import Recorder, recording
from robosim.playback.writer import REWARD_STEPS


class OnStep(Protocol):
    """Called after every decision, with the pellets delivered by then."""

    def __call__(self, step: int, delivered: int) -> None: ...


class Recorded(NamedTuple):
    """What came of a recording."""

    decisions: int
    """Run, also those that no span asked for; fewer than asked for after an interrupt."""
    delivered: int
    """Pellets by then."""


def record_episode(
    controller: Controller,
    env: VectorEnv,
    path: str | Path,
    *,
    about: Mapping[str, str] | None = None,
    on_step: OnStep | None = None,
    viewer: str = "",
) -> Recorded:
    """Run a new episode of the first environment of `env` and record it to `path`.

    A viewer that listens at the URL `viewer` is shown it meanwhile. An interrupt (Ctrl-C) ends the episode
    early: what has been recorded is kept. Raises InputError before anything runs if `path` cannot be written.
    `env` must have been made with `autoreset=False`, or the last frame would show the next episode.
    """
    if env.autoreset:
        raise ValueError("record_episode needs an environment with autoreset=False")
    with recording(path, env.arena, robots=env.robots, about=about, viewer=viewer) as recorder:
        return _record(env, _by_controller(controller, env), recorder, [(0, env.episode_steps + 1)], on_step)


def record_trajectory(
    trajectory: Trajectory,
    path: str | Path,
    *,
    about: Mapping[str, str] | None = None,
    spans: Sequence[tuple[int, int]] | None = None,
    on_step: OnStep | None = None,
    viewer: str = "",
    source: str = "trajectory",
) -> Recorded:
    """Run `trajectory` again and record it to `path`, in the detail of a recording made live.

    A viewer that listens at the URL `viewer` is shown it as it goes on.

    `spans` are the decisions to record, each from a first one up to, not including, a last; without them
    all are. Decision 0 is the start, and `len(trajectory.chosen)` the last. Spans may overlap and reach
    beyond the end; `widened` says which decisions are taken in beside them.
    Between them the picture stands still, and the lanes are empty. Clogs are those of the whole run as far as
    it runs: a little beyond the last span, since only time separates a clog from a short standstill.

    An interrupt (Ctrl-C) ends the run early: what has been recorded is kept. Raises InputError before
    anything runs if `path` cannot be written or the trajectory cannot be run; `source` is what the error
    calls it. ValueError for a span that is empty or begins before 0.
    """
    wanted = widened(spans, len(trajectory.chosen))
    env = begun(trajectory, source)
    with recording(path, env.arena, robots=env.robots, about=about, viewer=viewer) as recorder:
        return _record(env, _by_trajectory(trajectory, env), recorder, wanted, on_step)


def widened(spans: Sequence[tuple[int, int]] | None, decisions: int) -> list[tuple[int, int]]:
    """Return the half-open spans of decisions that are recorded for `spans`, in order and apart.

    Each begins and ends at a multiple of `REWARD_STEPS`, or with the run: so the pheromone map and the
    rewards, which are written every few decisions, are written as in a recording of all. All of the run,
    0 to `decisions` and both included, for None. ValueError for a span that is empty or begins before 0.
    """
    end_of_run = decisions + 1
    merged: list[tuple[int, int]] = []
    for start, end in sorted([(0, end_of_run)] if spans is None else spans):
        if not 0 <= start < end:
            raise ValueError(f"span ({start}, {end}): it must begin at 0 or later, and end after that")
        if start >= end_of_run:
            continue
        start -= start % REWARD_STEPS
        end = min(end + -end % REWARD_STEPS, end_of_run)
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged


def decisions_run(spans: Sequence[tuple[int, int]], decisions: int, arena: Arena) -> int:
    """Return how many of `decisions` are run to record `spans` of a trajectory in `arena`."""
    wanted = widened(spans, decisions)
    return _last_run(wanted, decisions, arena) if wanted else 0


def _last_run(spans: Sequence[tuple[int, int]], decisions: int, arena: Arena) -> int:
    return min(spans[-1][1] - 1 + decisions_until_certain(arena), decisions)


class FoundClogs(NamedTuple):
    """What came of watching for clogs."""

    arena: Arena
    clogs: list[Clog]


def watch_episode(controller: Controller, env: VectorEnv, *, on_step: OnStep | None = None) -> FoundClogs:
    """Run a new episode of the first environment of `env`, without a recording; return its clogs."""
    return _watch(env, _by_controller(controller, env), on_step)


def watch_trajectory(
    trajectory: Trajectory, *, on_step: OnStep | None = None, source: str = "trajectory"
) -> FoundClogs:
    """Run `trajectory` again, without a recording; return its clogs.

    Raises InputError if it cannot be run; `source` is what the error calls it.
    """
    env = begun(trajectory, source)
    return _watch(env, _by_trajectory(trajectory, env), on_step)


def _by_controller(controller: Controller, env: VectorEnv) -> Callable[[], None]:
    """Begin a new episode; return what takes its next decision."""
    observation = env.reset()
    controller.reset(env)

    def decide() -> None:
        nonlocal observation
        observation = env.step(controller.act(env, observation)).observation

    return decide


def _by_trajectory(trajectory: Trajectory, env: VectorEnv) -> Callable[[], None]:
    """Return what takes the next decision of a trajectory again."""

    def decide() -> None:
        env.step(trajectory.chosen[env.steps_taken][None])

    return decide


def _watch(env: VectorEnv, decide: Callable[[], None], on_step: OnStep | None) -> FoundClogs:
    monitor = EpisodeMonitor(env.arena, env.robots)
    monitor.add(env.frame())
    while env.steps_taken < env.episode_steps:
        decide()
        monitor.add(env.frame())
        if on_step is not None:
            on_step(env.steps_taken, int(env.delivered[0].sum()))
    return FoundClogs(env.arena, clogs_among(monitor.finish().standstills))


def spans_around(clogs: Sequence[Clog], seconds: float, arena: Arena) -> list[tuple[int, int]]:
    """Return the decisions of each clog with `seconds` before and after it, for `record_trajectory`."""
    more = round(seconds / arena.timing.decision_period)
    return [(max(0, clog.start - more), clog.end + more + 1) for clog in clogs]


def _record(
    env: VectorEnv,
    decide: Callable[[], None],
    recorder: Recorder,
    spans: Sequence[tuple[int, int]],
    on_step: OnStep | None,
) -> Recorded:
    def run_to(step: int, take: Callable[[Frame], None]) -> None:
        while env.steps_taken < step:
            decide()
            take(env.frame())
            if on_step is not None:
                on_step(env.steps_taken, int(env.delivered[0].sum()))

    profile, drawn = env.config.profile, env.drawn
    if profile is not None and drawn is not None:
        recorder.tell_drawn(profile, drawn[0])
    try:
        for number, (start, end) in enumerate(spans):
            if number == 0:
                (recorder.add if start == 0 else recorder.skip)(env.frame())
            run_to(start - 1, recorder.skip)
            run_to(end - 1, recorder.add)
        if spans:
            run_to(_last_run(spans, env.episode_steps, env.arena), recorder.skip)
    except KeyboardInterrupt:
        pass
    return Recorded(env.steps_taken, int(env.delivered[0].sum()))
