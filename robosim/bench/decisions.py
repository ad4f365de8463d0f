"""What a decision costs, against the floor under it: the time inside bare `Space.step`."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.arena import Arena, load_arena
from robosim.bench.traffic import SPREAD_OUT, recorded_traffic
from robosim.envs.vector import VectorEnv
from robosim.world.physics import PhysicsWorld
from robosim.world.physics.bodies import Bodies

ROBOTS = (1, 8, 32)
ENVS = (1, 16)
REPEATS = 3
"""Each case is timed as often, and its median repeat reported."""


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of one case, as processor time of the one thread that runs it."""

    robots: int
    envs: int
    pellets: int
    decisions: int
    """Joint decisions timed, over all environments."""
    seconds: float
    """Of all of them: driver, physics, contacts, pellets, pheromones, observations and rewards."""
    floor_seconds: float
    """Of the part inside bare `Space.step`."""

    @property
    def joint_decisions_per_second(self) -> float:
        return self.decisions / self.seconds

    @property
    def robot_decisions_per_second(self) -> float:
        return self.decisions * self.robots / self.seconds

    @property
    def floor_share(self) -> float:
        return self.floor_seconds / self.seconds

    @property
    def ratio(self) -> float:
        """How many times the floor a decision costs."""
        return self.seconds / self.floor_seconds

    def as_record(self) -> dict[str, float | int]:
        """Return the fields and what is derived from them, for a JSON file."""
        return {
            **dataclasses.asdict(self),
            "joint_decisions_per_second": self.joint_decisions_per_second,
            "robot_decisions_per_second": self.robot_decisions_per_second,
            "floor_share": self.floor_share,
            "ratio": self.ratio,
        }


class _Stopwatch:
    """Adds up the processor time spent inside the solver."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def watch(self, space: Bodies) -> None:
        advance = space.advance

        def timed() -> None:
            began = time.thread_time()
            advance()
            self.seconds += time.thread_time() - began

        space.advance = timed  # type: ignore[method-assign]  # one instance, for the time of a measurement


def measure(
    decisions: int, robots: Sequence[int] = ROBOTS, envs: Sequence[int] = ENVS, arena: str = "paper"
) -> Iterator[Cost]:
    """Yield the cost of every case: robots, environments, with and without pellets.

    `decisions` is how many joint decisions of a single environment a repeat times; a batch times as
    many rounds as bring it to at least four times that. The lane keeper's actions are recorded
    first and replayed under the clock, with and without pellets, so that traffic is real and the
    controller costs nothing.
    """
    full = load_arena(arena)
    empty = dataclasses.replace(full, pellets=dataclasses.replace(full.pellets, count=0))
    for team, batch in itertools.product(robots, envs):
        rounds = max(decisions // (1 if batch == 1 else 4), 1)
        actions = recorded_traffic(full, team, batch, SPREAD_OUT + rounds)
        for chosen in (full, empty):
            repeats = sorted(_time_once(chosen, team, batch, actions) for _ in range(REPEATS))
            seconds, floor = repeats[REPEATS // 2]
            yield Cost(team, batch, chosen.pellets.count, rounds * batch, seconds, floor)


def _time_once(arena: Arena, robots: int, envs: int, actions: NDArray[np.int64]) -> tuple[float, float]:
    """Return the processor time of the decisions after the spreading out, and of the solver's part in it."""
    env = VectorEnv(arena, robots=robots, num_envs=envs)
    world = env.world
    assert isinstance(world, PhysicsWorld)  # noqa: S101  what is under the clock, and what mypy cannot know
    env.reset()
    for chosen in actions[:SPREAD_OUT]:
        env.step(chosen)
    watch = _Stopwatch()
    for space in world.spaces:
        watch.watch(space)
    began = time.thread_time()
    for chosen in actions[SPREAD_OUT:]:
        env.step(chosen)
    return time.thread_time() - began, watch.seconds
