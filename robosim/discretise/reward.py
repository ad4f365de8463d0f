"""The reward of the paper: four signals, weighted, local or shared by the team."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

RewardKind = Literal["local", "global"]
REWARD_KINDS: tuple[RewardKind, ...] = ("local", "global")
Sharing = Literal["copied", "split"]


CLOSER_SHARE = 0.1
"""Progress toward the goal that counts as closer, as a share of a decision's way at top speed."""


@dataclass(frozen=True, slots=True)
class RewardConfig:
    """Signals and weights (the paper's section on the reward function)."""

    kind: RewardKind = "global"
    """`global` shares pickups and deliveries with the whole team, `local` keeps them to the robot."""
    sharing: Sharing = "copied"
    """How a global reward is shared: every robot gets the same full value, or an equal part of it.

    The paper says both; `copied` is the default because its clarifying sentence says so ("assigns
    the same reward value to all agents") and because the signal does not shrink with the team.
    """
    signed_progress: bool = False
    """Pay for progress toward the goal by its length, and charge as much for losing ground.

    The paper pays a fixed sum for any decision that brings the robot closer, and nothing for one that takes
    it away, so a robot that goes to and fro is paid every other decision for nothing.
    """
    idle_cost: bool = False
    """Charge a robot for every decision without making way what progress at top speed would have paid.

    The paper fines collisions but not standing, so two robots that meet do best to wait for each other.
    """
    distance: float = 2.5
    collision: float = -2.0
    pickup: float = 50.0
    delivery: float = 50.0
    distance_weight: float = 0.2
    collision_weight: float = 0.2
    pickup_weight: float = 0.2
    delivery_weight: float = 0.4


def rewards(
    config: RewardConfig,
    progress: NDArray[np.float64],
    collided: NDArray[np.bool_],
    laden: NDArray[np.bool_],
    pickups: NDArray[np.int64],
    deliveries: NDArray[np.int64],
    idle: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return the rewards [envs, robots] of one decision, r = w_d r_d + w_c r_c + w_p r_p + w_s r_s.

    All arguments are [envs, robots]: `progress` toward the goal as a share of a decision's way at top
    speed, of which `CLOSER_SHARE` counts as closer, `collided` with
    another robot, `laden` before the decision (laden robots are not penalised), first `pickups` of
    pellets, `deliveries`, and whether it made no way (`idle`).
    """
    team = (config.pickup_weight * config.pickup) * pickups
    team = team + (config.delivery_weight * config.delivery) * deliveries
    if config.kind == "global":
        robots = team.shape[1]
        team = team.sum(axis=1, keepdims=True)
        if config.sharing == "split":
            team = team / robots
    paid = np.clip(progress, -1.0, 1.0) if config.signed_progress else progress > CLOSER_SHARE
    own = (config.distance_weight * config.distance) * paid
    own = own + (config.collision_weight * config.collision) * (collided & ~laden)
    if config.idle_cost:
        own = own - (config.distance_weight * config.distance) * idle
    return np.asarray(team + own)
