"""Reading contacts out of the solver: raw rows per control period, sorted out once per decision."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Timing
from robosim.world.contacts import ContactKind, Contacts, no_contacts
from robosim.world.physics.bodies import Bodies

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_ROBOT_ROBOT = np.uint8(ContactKind.ROBOT_ROBOT)
LOOSE_PELLET, WALL = -1, -2
"""Owners of bodies that are no part of a robot."""
_KIND_OF_OTHER = np.array(
    [ContactKind.ROBOT_ROBOT, ContactKind.ROBOT_WALL, ContactKind.ROBOT_PELLET], dtype=np.uint8
)
"""Indexed by the owner of the second body: 0 for any robot, and the two negative owners from the end."""


class ContactLog:
    """Collects the contacts of all environments during a decision."""

    def __init__(self, num_envs: int, robots: int, pellets: int, control_steps: int) -> None:
        self._robots = robots
        self._bodies = robots + pellets
        # Owner of every body of every environment: robots own themselves, one more column for walls.
        self._owner = np.full((num_envs, self._bodies + 1), LOOSE_PELLET)
        self._owner[:, :robots] = np.arange(robots)
        self._owner[:, -1] = WALL
        self._num_envs = num_envs
        self._slots = np.arange(num_envs * control_steps)
        self._sorted_ids = np.zeros(0, dtype=np.uintp)
        self._body_of_rank = np.zeros(0, dtype=np.int64)
        self.clear()

    def know_bodies(self, ids: NDArray[np.uintp]) -> None:
        """Learn the ids [envs, robots + pellets] of all bodies at the start of their episodes."""
        everyone = ids.ravel()
        order = np.argsort(everyone, kind="stable")
        self._sorted_ids = everyone[order]
        self._body_of_rank = order % self._bodies

    def clear(self) -> None:
        """Forget everything: a new decision begins."""
        self._lengths: list[list[int]] = [[0] for _ in range(self._num_envs)]

    def add(self, env: int, length: int) -> None:
        """Take in how long an environment's list of contacts is at the end of a control period."""
        self._lengths[env].append(length)

    def read(self, spaces: Sequence[Bodies], holder: Integers, times: Floats, timing: Timing) -> Contacts:
        """Return the decision's contacts that concern a robot, in an order that does not depend on memory.

        Bodies that have parted again before the end of the control period are listed too, with
        impulse 0 and no place.

        `holder` [envs, pellets] is the robot that holds a pellet, or -1; `times` [envs] the end of
        the decision in s. What touches a held pellet touches its robot.
        """
        if not any(lengths[-1] for lengths in self._lengths):
            return no_contacts()
        listed = [space.contacts() for space in spaces]
        ids, rows = listed[0]
        if len(listed) > 1:
            ids = np.concatenate([part for part, _ in listed])
            rows = np.concatenate([part for _, part in listed])
        rank = self._sorted_ids.searchsorted(ids)
        np.minimum(rank, len(self._sorted_ids) - 1, out=rank)
        bodies = self._body_of_rank[rank]
        bodies[self._sorted_ids[rank] != ids] = self._bodies
        lengths = np.array(self._lengths)
        sizes = lengths[:, 1:] - lengths[:, :-1]
        slot = self._slots.repeat(sizes.ravel())
        row_envs = slot // timing.control_steps
        self._owner[:, self._robots : -1] = holder
        owners = self._owner.take(bodies + (self._bodies + 1) * row_envs[:, None])
        one, other = owners[:, 0], owners[:, 1]
        concerns = ((np.maximum(one, other) >= 0) & (one != other)).nonzero()[0]
        if not concerns.size:
            return no_contacts()
        owners, bodies, rows = owners[concerns], bodies[concerns], rows[concerns]
        slot, envs = slot[concerns], row_envs[concerns]
        period = slot - envs * timing.control_steps
        # Robots before everything else, lower ones first: one of the two orders in which a pair can come.
        swap = (owners[:, 1] >= 0) & ((owners[:, 0] < 0) | (owners[:, 1] < owners[:, 0]))
        owners[swap] = owners[swap, ::-1]
        bodies[swap] = bodies[swap, ::-1]
        a, other = owners[:, 0], owners[:, 1]
        kind = _KIND_OF_OTHER[np.minimum(other, 0)]
        b = np.where(other == LOOSE_PELLET, bodies[:, 1] - self._robots, np.maximum(other, -1))
        # The solver lists contacts by the addresses of its shapes, which differ between processes.
        span = self._bodies + 1
        key = ((slot * len(ContactKind) + kind) * span + bodies[:, 0]) * span + bodies[:, 1]
        # A robot in a corner touches two walls, which have one key and differ by the place.
        order = np.lexsort((rows[:, 3], rows[:, 2], key))
        time = times[envs] - (timing.control_steps - 1 - period) * timing.control_period
        impulse = np.sqrt(rows[:, 0] ** 2 + rows[:, 1] ** 2)
        return Contacts(
            envs[order], time[order], kind[order], a[order], b[order], rows[order, 2:], impulse[order]
        )


def lasting(contacts: Contacts) -> Contacts:
    """Return the contacts that still press as their control period ends: they have a place and an impulse."""
    pressing = contacts.impulse > 0.0
    return contacts if np.count_nonzero(pressing) == len(pressing) else contacts.where(pressing)


def mark_touched(touched: NDArray[np.bool_], contacts: Contacts) -> None:
    """Set who touched what in `touched` [3, envs, robots], cleared before, from a decision's contacts."""
    if contacts.kind.size:
        touched[contacts.kind, contacts.env, contacts.a] = True
        between = np.flatnonzero(contacts.kind == _ROBOT_ROBOT)
        touched[_ROBOT_ROBOT, contacts.env[between], contacts.b[between]] = True


def touching_pellets(space: Bodies, robots: int) -> Integers:
    """Return the pairs [n, 2] of pellets that touched in the decision, the lower one first, sorted."""
    ids, _ = space.contacts()
    known = space.body_ids[robots:]
    order = np.argsort(known)
    rank = np.minimum(np.searchsorted(known, ids, sorter=order), len(known) - 1)
    found = (known[order[rank]] == ids).all(axis=1)
    pairs = np.sort(order[rank[found]], axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
