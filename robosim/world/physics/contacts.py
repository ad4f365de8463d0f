"""Reading contacts out of the solver: raw rows per control period, sorted out once per decision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Timing
from robosim.world.contacts import ContactKind, Contacts, no_contacts
from robosim.world.physics.space import EpisodeSpace
from robosim.world.state import WorldState

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

WALL, LOOSE_PELLET = -1, -2
"""Owners of bodies that are no part of a robot."""


class ContactLog:
    """Collects the contacts of all environments during a decision."""

    def __init__(self, num_envs: int, robots: int, pellets: int) -> None:
        self._robots = robots
        self._bodies = robots + pellets
        # Owner of every body of every environment: robots own themselves, one more column for walls.
        self._owner = np.full((num_envs, self._bodies + 1), LOOSE_PELLET)
        self._owner[:, :robots] = np.arange(robots)
        self._owner[:, -1] = WALL
        self._num_envs = num_envs
        self._ids_by_env = np.zeros((num_envs, self._bodies), dtype=np.uintp)
        self._sorted_ids = np.zeros(0, dtype=np.uintp)
        self._body_of_rank = np.zeros(0, dtype=np.int64)
        self.clear()

    def know_bodies(self, env: int, ids: NDArray[np.uintp]) -> None:
        """Learn the ids [robots + pellets] of an environment's bodies at the start of its episode."""
        self._ids_by_env[env] = ids
        everyone = self._ids_by_env.ravel()
        order = np.argsort(everyone, kind="stable")
        self._sorted_ids = everyone[order]
        self._body_of_rank = order % self._bodies

    def clear(self) -> None:
        """Forget everything: a new decision begins."""
        self._ids: list[NDArray[np.uintp]] = []
        self._rows: list[Floats] = []
        self._envs: list[int] = []
        self._sizes: list[int] = []

    def add(self, env: int, space: EpisodeSpace) -> None:
        """Take the contacts of the control period that has just passed."""
        ids, rows = space.arbiters()
        self._ids.append(ids.copy())
        self._rows.append(rows.copy())
        self._envs.append(env)
        self._sizes.append(len(rows))

    def read(self, holder: Integers, times: Floats, timing: Timing) -> Contacts:
        """Return the decision's contacts that concern a robot, in an order that does not depend on memory.

        `holder` [envs, pellets] is the robot that holds a pellet, or -1; `times` [envs] the end of
        the decision in s. What touches a held pellet touches its robot.
        """
        sizes = np.array(self._sizes)
        if not sizes.any():
            return no_contacts()
        ids = np.concatenate(self._ids)
        rows = np.concatenate(self._rows)
        rank = np.minimum(np.searchsorted(self._sorted_ids, ids), len(self._sorted_ids) - 1)
        bodies = np.where(self._sorted_ids[rank] == ids, self._body_of_rank[rank], self._bodies)
        envs = np.repeat(self._envs, sizes)
        periods = np.arange(len(sizes)) // self._num_envs
        ago = np.repeat((timing.control_steps - 1 - periods) * timing.control_period, sizes)
        self._owner[:, self._robots : -1] = np.where(holder >= 0, holder, LOOSE_PELLET)
        owners = self._owner[envs[:, None], bodies]
        concerns = (owners.max(axis=1) >= 0) & (owners[:, 0] != owners[:, 1])
        if not concerns.any():
            return no_contacts()
        owners, bodies, rows, envs = owners[concerns], bodies[concerns], rows[concerns], envs[concerns]
        time = times[envs] - ago[concerns]
        both = owners.min(axis=1) >= 0
        first_is_robot = owners[:, 0] >= 0
        robot = np.where(first_is_robot, owners[:, 0], owners[:, 1])
        other_owner = np.where(first_is_robot, owners[:, 1], owners[:, 0])
        other_body = np.where(first_is_robot, bodies[:, 1], bodies[:, 0])
        a = np.where(both, owners.min(axis=1), robot)
        pellet = np.where(other_owner == LOOSE_PELLET, other_body - self._robots, WALL)
        b = np.where(both, owners.max(axis=1), pellet)
        kind = np.where(
            both,
            ContactKind.ROBOT_ROBOT,
            np.where(other_owner == WALL, ContactKind.ROBOT_WALL, ContactKind.ROBOT_PELLET),
        ).astype(np.uint8)
        impulse = np.sqrt(rows[:, 0] ** 2 + rows[:, 1] ** 2)
        # The solver lists contacts by the addresses of its shapes, which differ between processes.
        order = np.lexsort((rows[:, 3], rows[:, 2], b, a, kind, time, envs))
        return Contacts(
            envs[order], time[order], kind[order], a[order], b[order], rows[order, 2:], impulse[order]
        )

    def mark_touched(self, state: WorldState, contacts: Contacts) -> None:
        """Set the touched flags of a state, cleared before, from the contacts of the decision."""
        between = contacts.kind == ContactKind.ROBOT_ROBOT
        state.touched_robot[contacts.env[between], contacts.a[between]] = True
        state.touched_robot[contacts.env[between], contacts.b[between]] = True
        wall = contacts.kind == ContactKind.ROBOT_WALL
        state.touched_wall[contacts.env[wall], contacts.a[wall]] = True
        pellet = contacts.kind == ContactKind.ROBOT_PELLET
        state.touched_pellet[contacts.env[pellet], contacts.a[pellet]] = True


def touching_pellets(space: EpisodeSpace, robots: int) -> Integers:
    """Return the pairs [n, 2] of pellets that touch, the lower one first, sorted."""
    ids, _ = space.arbiters()
    known = space.body_ids[robots:]
    order = np.argsort(known)
    rank = np.minimum(np.searchsorted(known, ids, sorter=order), len(known) - 1)
    found = (known[order[rank]] == ids).all(axis=1)
    pairs = np.sort(order[rank[found]], axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
