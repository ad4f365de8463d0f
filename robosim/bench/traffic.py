"""The traffic that is replayed under the clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena import Arena
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv
from robosim.world.factory import WorldKind

SPREAD_OUT = 150
"""Decisions before the clock starts, in which the team leaves home and reaches the source."""


def recorded_traffic(
    arena: Arena, robots: int, envs: int, rounds: int, world: WorldKind = "physics"
) -> NDArray[np.int64]:
    """Return the actions [rounds, envs, robots] of the lane keeper, so that a replay pays for none of it."""
    env = VectorEnv(arena, robots=robots, num_envs=envs, world=world)
    observation = env.reset()
    lanes = LanesController()
    lanes.reset(env)
    actions = np.empty((rounds, envs, robots), dtype=np.int64)
    for step in range(rounds):
        actions[step] = lanes.act(env, observation)
        observation = env.step(actions[step]).observation
    return actions
