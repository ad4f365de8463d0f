"""What truly happened in a decision: rewards and the metrics of learning, whatever the robots perceived."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.location import Location
from robosim.discretise.reward import RewardConfig, rewards
from robosim.robot.drivers import STOP
from robosim.world.contacts import ContactKind
from robosim.world.spacing import to_nearest
from robosim.world.state import Setting, WorldState

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Motion(NamedTuple):
    """Who has hardly moved in a decision; both [envs, robots]."""

    displaced_little: Bools
    turned_little: Bools

    @property
    def still(self) -> Bools:
        return self.displaced_little & self.turned_little


def encounters(actions: Integers, touched: Bools, refused: Bools, motion: Motion) -> tuple[Bools, Bools]:
    """Return who has collided with another robot and who is blocked, both [envs, robots].

    Collided is who `touched` [3, envs, robots] another robot while under way; blocked is who was under way,
    touched anything and hardly moved, or whose move onto a cell was `refused` [envs, robots].
    """
    under_way = actions != STOP
    other_robot, wall, pellet = touched
    collided = under_way & other_robot
    blocked = (under_way & motion.still & (other_robot | wall | pellet)) | refused
    return collided, blocked


class Truth:
    """Judges decisions by the state of the world, [envs, robots, ...]."""

    def __init__(self, setting: Setting, reward: RewardConfig) -> None:
        shape = setting.num_envs, setting.robots
        self._reward = reward
        self._per_travel = 1.0 / setting.travel
        self.collided: Bools = np.zeros(shape, dtype=np.bool_)
        """[envs, robots] touched another robot while under way in the last decision."""
        self.blocked: Bools = np.zeros(shape, dtype=np.bool_)
        """[envs, robots] under way, in touch with something, and hardly moved in the last decision."""
        self._laden: Bools = np.zeros(shape, dtype=np.bool_)
        self._paid = np.zeros((setting.num_envs, setting.arena.pellets.count), dtype=np.bool_)

    def reset(self, state: WorldState) -> None:
        """Begin an episode in every environment."""
        self.collided = np.zeros_like(self.collided)
        self.blocked = np.zeros_like(self.blocked)
        self._laden = state.held >= 0
        self._paid.fill(False)

    def judge(
        self, actions: Integers, state: WorldState, before: Location, now: Location, motion: Motion
    ) -> Floats:
        """Take in what `actions` [envs, robots] have led to; returns the rewards [envs, robots]."""
        self.collided, self.blocked = encounters(actions, state.touched, state.refused, motion)
        was_laden, self._laden = self._laden, state.held >= 0
        gained = before.distances - now.distances
        toward_goal = np.where(was_laden, gained[..., 0], gained[..., 1])
        return rewards(
            self._reward,
            gained=toward_goal * self._per_travel,
            collided=self.collided,
            laden=was_laden,
            pickups=self._first_pickups(state),
            deliveries=state.deliveries,
            idle=motion.displaced_little,
            touching=state.touched[ContactKind.ROBOT_ROBOT],
            nearest=None if self._reward.spacing is None else to_nearest(state.pose),
        )

    def _first_pickups(self, state: WorldState) -> Integers:
        """Return which robots took a pellet that nobody has been paid for, and mark it as paid."""
        taken = state.picked >= 0
        first = taken.astype(np.int64)
        self._paid[state.fresh] = False
        if np.count_nonzero(taken):
            envs, robots = np.nonzero(taken)
            pellets = state.picked[envs, robots]
            first[envs, robots] = ~self._paid[envs, pellets]
            self._paid[envs, pellets] = True
        return first
