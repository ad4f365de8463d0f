"""What truly happened in a decision: rewards and the metrics of learning, whatever the robots perceived."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Zone
from robosim.discretise.location import Location
from robosim.discretise.reward import Outcome, RewardConfig, find_reward, rewards
from robosim.robot.drivers import STOP
from robosim.robot.team import Role
from robosim.world.contacts import ContactKind
from robosim.world.spacing import to_nearest
from robosim.world.state import ABSENT, Setting, WorldState

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
        """Take what is judged by; InputError for an extra reward that nobody has registered."""
        shape = setting.num_envs, setting.robots
        self._reward = reward
        self._extra = None if reward.extra is None else find_reward(reward.extra)
        self._setting = setting
        self._per_travel = 1.0 / setting.travel
        self.collided: Bools = np.zeros(shape, dtype=np.bool_)
        """[envs, robots] touched another robot while under way in the last decision."""
        self.blocked: Bools = np.zeros(shape, dtype=np.bool_)
        """[envs, robots] who was blocked in the last decision, as `encounters` says."""
        self.handed_over: Integers = np.zeros(shape, dtype=np.int64)
        """[envs, robots] pellets that excavators handed over for the first time in the last decision."""
        self.hands_over = (setting.team.role == Role.EXCAVATOR) if setting.team.role.any() else None
        """[robots] who hands over; None where everybody does all the work."""
        self._was_held: Integers = np.full(shape, -1)
        self._laden: Bools = np.zeros(shape, dtype=np.bool_)
        legs = 1 if setting.team.all_round else 2
        self._leg = legs // 2 * (setting.team.role == Role.TRANSPORTER)
        self._paid = np.zeros((legs, setting.num_envs, setting.arena.pellets.count), dtype=np.bool_)
        """[legs, envs, pellets] somebody has been paid for taking it in the source, or in the hand-over."""
        self._handed = np.zeros(self._paid.shape[1:], dtype=np.bool_)
        """[envs, pellets] somebody has been paid for handing it over."""
        self._zones, self._per_cell = setting.arena.zones, 1.0 / setting.arena.cell_size

    def reset(self, state: WorldState) -> None:
        """Begin an episode in every environment."""
        self.collided = np.zeros_like(self.collided)
        self.blocked = np.zeros_like(self.blocked)
        self._laden = state.held >= 0
        self.handed_over = np.zeros_like(self.handed_over)
        self._was_held = state.held.copy()
        self._handed.fill(False)
        self._paid.fill(False)

    def judge(
        self, actions: Integers, state: WorldState, before: Location, now: Location, motion: Motion
    ) -> Floats:
        """Take in what `actions` [envs, robots] have led to; returns the rewards [envs, robots].

        InputError for what an extra reward may not return.
        """
        self.collided, self.blocked = encounters(actions, state.touched, state.refused, motion)
        was_laden, self._laden = self._laden, state.held >= 0
        gained = before.distances - now.distances
        toward_goal = np.where(was_laden, gained[..., 0], gained[..., 1])
        pickups = self._first_pickups(state)
        deliveries = state.deliveries
        if self.hands_over is not None:
            self.handed_over = self._first_handovers(state, self.hands_over)
            deliveries = np.where(self.hands_over, self.handed_over, deliveries)
        share = toward_goal * self._per_travel
        paid = rewards(
            self._reward,
            gained=share,
            collided=self.collided,
            laden=was_laden,
            pickups=pickups,
            deliveries=deliveries,
            idle=motion.displaced_little,
            touching=state.touched[ContactKind.ROBOT_ROBOT],
            nearest=None if self._reward.spacing is None else to_nearest(state.pose),
        )
        if self._extra is None:
            return paid
        outcome = Outcome(
            reward=paid,
            actions=actions,
            state=state,
            setting=self._setting,
            gained=share,
            laden=was_laden,
            pickups=pickups,
            deliveries=deliveries,
            collided=self.collided,
            blocked=self.blocked,
        )
        return paid + self._extra(outcome)

    def _first_pickups(self, state: WorldState) -> Integers:
        """Return which robots took a pellet that nobody has been paid for, and mark it as paid.

        Transporters are paid for taking what was handed over, whoever was paid for digging it.
        """
        taken = state.picked >= 0
        first = taken.astype(np.int64)
        for leg in self._paid:
            leg[state.fresh] = False
        if np.count_nonzero(taken):
            envs, robots = np.nonzero(taken)
            pellets = state.picked[envs, robots]
            leg = self._leg[robots]
            first[envs, robots] = ~self._paid[leg, envs, pellets]
            self._paid[leg, envs, pellets] = True
        return first

    def _first_handovers(self, state: WorldState, hands_over: Bools) -> Integers:
        """Return which robots' pellets lie in the hand-over, or were taken there, for the first time.

        That is what an excavator held before the decision and holds no more.
        """
        was_held, self._was_held = self._was_held, state.held.copy()
        self._handed[state.fresh] = False
        handed = np.zeros_like(self.handed_over)
        envs, robots = np.nonzero(hands_over & (was_held >= 0) & (state.held != was_held))
        if len(envs):
            pellets = was_held[envs, robots]
            column, row = (state.pellets[envs, pellets] * self._per_cell).astype(np.int64).T
            there = self._zones[row, column] == Zone.HANDOVER
            there &= state.pellet_status[envs, pellets] != ABSENT
            handed[envs, robots] = there & ~self._handed[envs, pellets]
            self._handed[envs, pellets] |= there
        return handed
