"""How much faster the grid is than the physics: the same team, batch and traffic in both."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass

import numpy as np

from robosim.arena import Arena, load_arena
from robosim.bench.traffic import SPREAD_OUT, recorded_traffic
from robosim.envs.vector import VectorEnv
from robosim.world.factory import WORLD_KINDS, WorldKind

ROBOTS = 8
ENVS = 64
TURNS = 3
"""Each world is timed as often, in turns, so that a busy machine slows both alike."""


@dataclass(frozen=True, slots=True)
class WorldCost:
    """What decisions cost in one world, as processor time of the one thread that runs it."""

    world: WorldKind
    robots: int
    envs: int
    decisions: int
    """Joint decisions timed, over all environments."""
    seconds: float
    """Of all of them: the world, pheromones, observations and rewards."""

    @property
    def joint_decisions_per_second(self) -> float:
        return self.decisions / self.seconds

    def as_record(self) -> dict[str, float | int | str]:
        """Return the fields and what is derived from them, for a JSON file."""
        return {
            **dataclasses.asdict(self),
            "joint_decisions_per_second": self.joint_decisions_per_second,
        }


def compare_worlds(decisions: int, arena: str = "paper") -> list[WorldCost]:
    """Return the cost of each world, in the order of `WORLD_KINDS`: the median of its turns.

    `decisions` is shared out among the environments; each world has the lane keeper's traffic, recorded
    before, and the grid, which is faster, four times as many rounds of it.
    """
    full = load_arena(arena)
    rounds = {"physics": max(decisions // 16, 1), "grid": max(decisions // 4, 1)}
    traffic = {
        world: recorded_traffic(full, ROBOTS, ENVS, SPREAD_OUT + rounds[world], world)
        for world in WORLD_KINDS
    }
    turns = [{world: _time_once(full, world, traffic[world]) for world in WORLD_KINDS} for _ in range(TURNS)]
    return [
        WorldCost(
            world, ROBOTS, ENVS, rounds[world] * ENVS, sorted(turn[world] for turn in turns)[TURNS // 2]
        )
        for world in WORLD_KINDS
    ]


def _time_once(arena: Arena, world: WorldKind, actions: np.ndarray) -> float:
    """Return the processor time of the decisions after the spreading out, s."""
    env = VectorEnv(arena, robots=ROBOTS, num_envs=ENVS, world=world)
    env.reset()
    for chosen in actions[:SPREAD_OUT]:
        env.step(chosen)
    began = time.thread_time()
    for chosen in actions[SPREAD_OUT:]:
        env.step(chosen)
    return time.thread_time() - began
