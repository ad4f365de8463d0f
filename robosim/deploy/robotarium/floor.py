"""What the laboratory lacks: pellets, grippers, walls and touches, worked out from the robots' poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.deploy.readings import Readings
from robosim.world.contacts import ContactKind
from robosim.world.state import ABSENT, HELD, LOOSE, Gripper

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

AHEAD = 0.025
"""The laboratory checks distances between points so far ahead of where robots' poses are, m."""
NEAR = 0.005
"""Gap at which bodies count as touching, m."""
NEAR_APART = 0.015
"""The same for robots that barrier certificates keep apart, which slow them down before, m."""
GAP = 1e-3
"""Kept around a fresh pellet, m."""
NOBODY = -1


class VirtualFloor:
    """Pellets of light: taken, carried, let go of, delivered and replaced as in the simulator.

    They are drawn, not pushed: robots drive over them. What happens in a decision happens in the order of
    `robosim.world.physics`.
    """

    def __init__(self, arena: Arena, robots: int, seed: int, apart: float = 0.0) -> None:
        """Lay the pellets; robots that are kept `apart` (m) count as touching where they come no nearer."""
        self._arena = arena
        self._rng = np.random.default_rng(seed)
        sheet, self._pellet_radius = arena.robot, arena.pellets.radius
        self._radius = sheet.outer_radius
        self._nose = 0.5 * sheet.length
        self._reach = self._pellet_radius + sheet.gripper_reach
        self._apart = apart + NEAR_APART if apart else 0.0
        self._home = (arena.zones == Zone.HOME).ravel()
        self._free = (arena.zones != Zone.WALL).ravel()
        count = arena.pellets.count
        self.pellets: Floats = self._rng.permutation(arena.pellet_places)[:count].copy()
        """[pellets, 2] m; an absent one keeps its last place."""
        self.status = np.full(count, LOOSE)
        """[pellets] `PelletStatus`."""
        self.held = np.full(robots, NOBODY, np.int64)
        """[robots] the pellet that a robot holds, or -1."""
        self.delivered = np.zeros(robots, np.int64)
        """[robots] pellets delivered, by who held them last."""
        self._last_holder = np.full(count, NOBODY, np.int64)
        self._touched = np.zeros((len(ContactKind), robots), np.bool_)

    def look(self, pose: Floats) -> None:
        """Note who touches what at poses [robots, 3]; to be called in every turn."""
        self._carry(pose)
        self._touched[ContactKind.ROBOT_ROBOT] |= self._touching_robots(pose)
        self._touched[ContactKind.ROBOT_WALL] |= self.clearance(pose[:, :2]) <= self._radius + NEAR
        apart = _apart(pose[:, :2], self.pellets) <= self._radius + self._pellet_radius
        self._touched[ContactKind.ROBOT_PELLET] |= (apart & (self.status == LOOSE)).any(axis=1)

    def readings(self, pose: Floats, time: float) -> Readings:
        """Return what the team's sensors say; touches are those since `begin`."""
        nearest, known, touching = self._feel(pose)
        return Readings(
            time=np.full(len(pose), time),
            pose=pose,
            laden=self.held != NOBODY,
            at_pellet=touching,
            touched=self._touched.copy(),
            pellet=np.where(known[:, None], self.pellets.take(nearest, axis=0), np.nan),
        )

    def act(self, pose: Floats, gripper: NDArray[np.int8]) -> None:
        """End a decision: grippers [robots] do as they were told, and pellets at home are replaced."""
        opened = (self.held != NOBODY) & (gripper == Gripper.OPEN)
        self._drop(pose, opened)
        self._deliver()
        self._refill(pose)
        nearest, _, touching = self._feel(pose)
        for robot in np.flatnonzero(touching & (gripper == Gripper.TAKE)).tolist():
            pellet = nearest[robot]
            # Another robot may have been quicker.
            if self.status[pellet] == LOOSE:
                self.held[robot] = pellet
                self.status[pellet] = HELD
                self._last_holder[pellet] = robot
        self._carry(pose)

    def begin(self) -> None:
        """Begin a decision: touches are noted from here on."""
        self._touched.fill(False)

    def clearance(self, places: Floats) -> Floats:
        """Return how far places [n, 2] are from the nearest wall, m, [n]; 0 inside of one."""
        walls = self._arena.walls
        low, high = walls[:, :2], walls[:, 2:]
        outside = np.maximum(np.maximum(low - places[:, None], places[:, None] - high), 0.0)
        return np.asarray(np.hypot(outside[..., 0], outside[..., 1]).min(axis=1))

    def stopped_by_walls(self, pose: Floats, speed: Floats, period: float) -> Bools:
        """Return whose `speed` [robots] (m/s) would lead into a wall within the `period` (s), [robots]."""
        heading = pose[:, 2]
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * (speed * period)[:, None]
        now, then = self.clearance(pose[:, :2]), self.clearance(pose[:, :2] + ahead)
        return np.asarray((then < self._radius) & (then < now))

    def _noses(self, pose: Floats, beyond: float = 0.0) -> Floats:
        """Return points [robots, 2] at the robots' noses, or so far beyond them (m)."""
        heading = pose[:, 2]
        return pose[:, :2] + (self._nose + beyond) * np.stack([np.cos(heading), np.sin(heading)], axis=-1)

    def _carry(self, pose: Floats) -> None:
        laden = self.held != NOBODY
        self.pellets[self.held[laden]] = self._noses(pose, self._pellet_radius)[laden]

    def _feel(self, pose: Floats) -> tuple[Integers, Bools, Bools]:
        """Return the loose pellet nearest to each gripper, if there is one, and if the gripper touches it."""
        apart = _apart(self._noses(pose), self.pellets)
        apart[:, self.status != LOOSE] = np.inf
        nearest = apart.argmin(axis=1)
        least = apart.min(axis=1)
        return nearest, np.isfinite(least), (least <= self._reach) & (self.held == NOBODY)

    def _touching_robots(self, pose: Floats) -> Bools:
        """Return who touches another robot or its pellet, or has its pellet touched, [robots]."""
        laden = np.flatnonzero(self.held != NOBODY)
        places = np.concatenate([pose[:, :2], self.pellets[self.held[laden]]])
        owner = np.concatenate([np.arange(len(pose)), laden])
        radius = np.repeat([self._radius, self._pellet_radius], [len(pose), len(laden)])
        near = _apart(places, places) <= radius[:, None] + radius + NEAR
        near &= owner[:, None] != owner
        touching = np.zeros(len(pose), np.bool_)
        touching[owner[near.any(axis=1)]] = True
        return touching | (checked_distances(pose) <= self._apart).any(axis=1)

    def _drop(self, pose: Floats, opened: Bools) -> None:
        robots = np.flatnonzero(opened)
        pellets = self.held[robots]
        # A gripper may reach into a wall, in which no pellet can lie.
        buried = ~self._free.take(self._cell(self.pellets[pellets]), mode="clip")
        self.pellets[pellets[buried]] = pose[robots[buried], :2]
        self.status[pellets] = LOOSE
        self.held[robots] = NOBODY

    def _deliver(self) -> None:
        home = self._home.take(self._cell(self.pellets), mode="clip") & (self.status == LOOSE)
        for pellet in np.flatnonzero(home).tolist():
            self.delivered[self._last_holder[pellet]] += 1
            self.status[pellet] = ABSENT

    def _refill(self, pose: Floats) -> None:
        arena = self._arena
        for pellet in np.flatnonzero(self.status == ABSENT).tolist():
            places = self._rng.permutation(arena.pellet_places)
            others = self.pellets[self.status != ABSENT]
            clear = (_apart(places, pose[:, :2]) >= self._radius + self._pellet_radius + GAP).all(axis=1)
            clear &= (_apart(places, others) >= 2.0 * self._pellet_radius + GAP).all(axis=1)
            if clear.any():
                self.pellets[pellet] = places[clear.argmax()]
                self.status[pellet] = LOOSE

    def _cell(self, places: Floats) -> Integers:
        cells = (places * (1.0 / self._arena.cell_size)).astype(np.int64)
        return np.asarray(cells[:, 1] * self._arena.columns + cells[:, 0])


def checked_distances(pose: Floats) -> Floats:
    """Return the distances [robots, robots] that the laboratory checks at poses [robots, 3], m.

    Those of robots from themselves are infinite.
    """
    heading = pose[:, 2]
    points = pose[:, :2] + AHEAD * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    apart = _apart(points, points)
    np.fill_diagonal(apart, np.inf)
    return apart


def _apart(some: Floats, others: Floats) -> Floats:
    """Return the distances [n, m] of places [n, 2] and [m, 2], m."""
    apart = some[:, None] - others
    return np.asarray(np.hypot(apart[..., 0], apart[..., 1]))
