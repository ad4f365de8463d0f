"""The reward of the paper: four signals, weighted, local or shared by the team, and what users add to it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from robosim.errors import InputError, nearest_names, shown
from robosim.plugins import load_plugins
from robosim.records import Record
from robosim.world.state import Setting, WorldState

RewardKind = Literal["local", "global"]
Sharing = Literal["copied", "split"]

_LARGEST = 1e6
_WEIGHTS = ("distance_weight", "collision_weight", "pickup_weight", "delivery_weight")

CLOSER_SHARE = 0.1
"""Distance gained toward the goal that counts as closer, as a share of what top speed gains."""


class RewardConfig(Record):
    """Signals and weights (the paper's section on the reward function)."""

    short_names = {"kind": "reward", "extra": "extra_reward"} | {
        name: name
        for name in (
            "sharing",
            "signed_distance",
            "idle_cost",
            "idle_weight",
            "touch_cost",
            "spacing",
            "spacing_cost",
            *_WEIGHTS,
        )
    }

    kind: RewardKind = "global"
    """`global` shares pickups and deliveries with the whole team, `local` keeps them to the robot."""
    sharing: Sharing = "copied"
    """How a global reward is shared: every robot gets the same full value (`copied`), or an equal part of it
    (`split`)."""
    # The paper says both; copied is the default because its clarifying sentence says so ("assigns the same
    # reward value to all agents") and because the signal does not shrink with the team.
    signed_distance: bool = False
    """Pay for distance gained toward the goal by its length, and charge as much for distance lost; the paper
    pays a fixed sum for any decision that brings a robot closer, so going to and fro is paid."""
    idle_cost: bool = False
    """Charge a robot for every decision without displacement what one at top speed would have paid; the paper
    fines collisions but not standing, so two robots that meet do best to wait for each other."""
    distance: float = Field(default=2.5, ge=-_LARGEST, le=_LARGEST)
    """r_d: for a decision that brings the robot closer to its goal."""
    collision: float = Field(default=-2.0, ge=-_LARGEST, le=_LARGEST)
    """r_c: for touching another robot under way, unladen."""
    pickup: float = Field(default=50.0, ge=-_LARGEST, le=_LARGEST)
    """r_p: for taking a pellet that nobody has been paid for; for a transporter, in the hand-over."""
    delivery: float = Field(default=50.0, ge=-_LARGEST, le=_LARGEST)
    """r_s: for a pellet brought home; for an excavator, for one handed over."""
    distance_weight: float = Field(default=0.2, ge=0, le=_LARGEST)
    """w_d."""
    collision_weight: float = Field(default=0.2, ge=0, le=_LARGEST)
    """w_c."""
    pickup_weight: float = Field(default=0.2, ge=0, le=_LARGEST)
    """w_p."""
    delivery_weight: float = Field(default=0.4, ge=0, le=_LARGEST)
    """w_s."""
    idle_weight: float | None = Field(default=None, ge=0, le=_LARGEST)
    """With `idle_cost`, the weight of its charge; none for w_d. So the pay for distance can be small, which a
    team that has learned hardly needs, and standing still costs."""
    touch_cost: float | None = Field(default=None, ge=0, le=_LARGEST)
    """Charged for a decision in which the robot, or the pellet it holds, touched another, whoever was under
    way and laden or not; in the grid, in which its move was refused by another. The paper fines only who is
    under way and unladen."""
    spacing: float | None = Field(default=None, gt=0, le=_LARGEST)
    """m: robots whose centres are nearer to each other than this as a decision ends are charged
    `spacing_cost`."""
    spacing_cost: float | None = Field(default=None, ge=0, le=_LARGEST)
    """Charged in full where two centres meet, and evenly less up to `spacing`; the nearest robot counts."""
    extra: str | None = Field(default=None, min_length=1, max_length=100)
    """Name of a function that `register_reward` knows, whose pay is added; none for none."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.spacing is None) != (self.spacing_cost is None):
            given, missing = (
                ("spacing_cost", "spacing") if self.spacing is None else ("spacing", "spacing_cost")
            )
            raise ValueError(f"{given} needs {missing}, too")
        if self.idle_weight is not None and not self.idle_cost:
            raise ValueError("idle_weight needs idle_cost, too")
        return self


def rewards(
    config: RewardConfig,
    gained: NDArray[np.float64],
    collided: NDArray[np.bool_],
    laden: NDArray[np.bool_],
    pickups: NDArray[np.int64],
    deliveries: NDArray[np.int64],
    idle: NDArray[np.bool_],
    touching: NDArray[np.bool_],
    nearest: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Return the rewards [envs, robots] of one decision, r = w_d r_d + w_c r_c + w_p r_p + w_s r_s.

    All arguments are [envs, robots]: the distance `gained` toward the goal as a share of what top speed gains
    in a decision, of which `CLOSER_SHARE` counts as closer; `collided` with another robot; `laden` before the
    decision (laden robots are not penalised); first `pickups` of pellets; `deliveries`; whether the robot was
    hardly displaced (`idle`); whether it was `touching` another at all; and how far off the centre of the
    `nearest` robot is (m), which may be None where `spacing` is.
    """
    team = (config.pickup_weight * config.pickup) * pickups
    team = team + (config.delivery_weight * config.delivery) * deliveries
    if config.kind == "global":
        robots = team.shape[1]
        team = team.sum(axis=1, keepdims=True)
        if config.sharing == "split":
            team = team / robots
    paid = np.clip(gained, -1.0, 1.0) if config.signed_distance else gained > CLOSER_SHARE
    own = (config.distance_weight * config.distance) * paid
    own = own + (config.collision_weight * config.collision) * (collided & ~laden)
    if config.idle_cost:
        weight = config.distance_weight if config.idle_weight is None else config.idle_weight
        own = own - (weight * config.distance) * idle
    if config.touch_cost is not None:
        own = own - config.touch_cost * touching
    if config.spacing is not None and config.spacing_cost is not None and nearest is not None:
        own = own - config.spacing_cost * np.clip(1.0 - nearest / config.spacing, 0.0, 1.0)
    return np.asarray(team + own)


class Outcome(NamedTuple):
    """What a decision has led to, in truth, whatever the robots perceived; to be read and not changed."""

    reward: NDArray[np.float64]
    """[envs, robots] what the decision pays without anything extra."""
    actions: NDArray[np.int64]
    """[envs, robots]."""
    state: WorldState
    """Where robots and pellets are now, what is held, and who touched what."""
    setting: Setting
    """The arena, the team, and how far a robot comes in a decision."""
    gained: NDArray[np.float64]
    """[envs, robots] distance gained toward the goal, as a share of what top speed gains in a decision."""
    laden: NDArray[np.bool_]
    """[envs, robots] held a pellet before the decision."""
    pickups: NDArray[np.int64]
    """[envs, robots] pellets taken for the first time since they were put into the source."""
    deliveries: NDArray[np.int64]
    """[envs, robots] pellets delivered; by an excavator, handed over."""
    collided: NDArray[np.bool_]
    """[envs, robots] touched another robot while under way."""
    blocked: NDArray[np.bool_]
    """[envs, robots] under way, in touch with something, and hardly moved."""


ExtraReward = Callable[[Outcome], NDArray[np.floating]]
"""Returns what is paid in addition, [envs, robots]."""
_REGISTERED: dict[str, ExtraReward] = {}


def register_reward(name: str, function: ExtraReward) -> None:
    """Make a function known by a name, for `RewardConfig.extra`, in the place of any that had it."""
    _REGISTERED[name] = function


def find_reward(name: str) -> ExtraReward:
    """Return the function of that name, which raises InputError for what it may not return.

    InputError where there is none, also in the modules that the user's environment names.
    """
    if name not in _REGISTERED:
        load_plugins()
    if name not in _REGISTERED:
        end = nearest_names(name, _REGISTERED) if _REGISTERED else "none is registered (register_reward)."
        raise InputError(f"unknown extra reward {shown(name)}: {end}")
    return partial(_checked_pay, name, _REGISTERED[name])


def _checked_pay(name: str, function: ExtraReward, outcome: Outcome) -> NDArray[np.float64]:
    paid = np.asarray(function(outcome))
    shape = outcome.reward.shape
    allowed = f"finite numbers, [envs, robots] = {list(shape)}"
    if paid.shape != shape or paid.dtype.kind not in "biuf":
        given = f"of type {paid.dtype} and shape {list(paid.shape)}"
        raise InputError(f"extra reward {shown(name)} returned an array {given}, but must return {allowed}.")
    if not np.isfinite(paid).all():
        wrong = paid[~np.isfinite(paid)][0]
        raise InputError(f"extra reward {shown(name)} returned {wrong}, but must return {allowed}.")
    return paid.astype(np.float64)
