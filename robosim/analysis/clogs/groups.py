"""Groups of robots that want to move and cannot, linked by contact, after each decision."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from robosim.analysis.measure.tunnels import Tunnels
from robosim.arena.model import Arena
from robosim.episodes.columns import FrameColumns
from robosim.robot.drivers import STOP
from robosim.world.contacts import ContactKind

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

HOLD = 3.0
"""Time without headway after which a robot is held up, s."""


class Groups(NamedTuple):
    """Who is in a group after each decision of a chunk."""

    label: Integers
    """[rows, robots] the lowest member of a robot's group, or -1."""
    link: Bools
    """[rows, robots, robots] who is linked to whom, within groups; symmetric, False on the diagonal."""
    pellet: Bools
    """[rows, robots] members that pressed on a loose pellet."""


class _Past(NamedTuple):
    """What is remembered of rows, for the window that ends in each."""

    place: Floats
    """[rows, robots, 2] m."""
    moving: Bools
    """[rows, robots] decided to move."""
    pressed: Bools
    """[rows, robots] was in touch with a loose pellet."""
    linked: Bools
    """[rows, robots, robots] touched each other, or the same loose pellet."""


class GroupFinder:
    """Takes chunks of frames; keeps the rows of the last `HOLD` seconds between them."""

    def __init__(self, arena: Arena, robots: int, tunnels: Tunnels) -> None:
        self._tunnels = tunnels
        self.hold = hold_decisions(arena)
        """`HOLD` in decisions."""
        self._still = 0.5 * arena.team(robots).sheet.length
        nobody = np.zeros((self.hold, robots), dtype=np.bool_)
        # Before the run everybody was elsewhere: nobody is held up in its first decisions.
        nowhere = np.full((self.hold, robots, 2), np.inf)
        self._past = _Past(nowhere, nobody, nobody, np.zeros((self.hold, robots, robots), np.bool_))

    def find(self, frames: FrameColumns) -> Groups:
        """Return the groups of the next rows."""
        hold, place = self.hold, frames.pose[: frames.rows, :, :2]
        pressed, linked = _touches(frames)
        past = self._past
        rows = _Past(
            np.concatenate([past.place, place]),
            np.concatenate([past.moving, frames.action[: frames.rows] != STOP]),
            np.concatenate([past.pressed, pressed]),
            np.concatenate([past.linked, linked]),
        )
        # Copies, so that the whole chunk is not kept alive by its last rows.
        self._past = _Past(
            rows.place[-hold:].copy(),
            rows.moving[-hold:].copy(),
            rows.pressed[-hold:].copy(),
            rows.linked[-hold:].copy(),
        )
        displacement = place - rows.place[: len(place)]
        held = displacement[..., 0] ** 2 + displacement[..., 1] ** 2 < self._still**2
        held &= 2 * _sums(rows.moving, hold) >= hold
        pellet = held & (_sums(rows.pressed, hold) > 0)
        link = (_sums(rows.linked, hold) > 0) & held[:, :, None] & held[:, None, :]
        cell_row, cell_column = self._tunnels.cells(place)
        at_tunnel = held & (self._tunnels.near[cell_row, cell_column] >= 0)
        label = np.full_like(held, -1, dtype=np.int64)
        # In the other rows everybody is alone, and none at a pellet.
        busy = (link.any(axis=2) | pellet).any(axis=1)
        label[busy] = _labelled(link[busy], pellet[busy], at_tunnel[busy])
        grouped = label >= 0
        return Groups(label, link & grouped[:, :, None], pellet & grouped)


def hold_decisions(arena: Arena) -> int:
    """Return how many decisions it takes to see that robots stand, or that they no longer do: `HOLD`."""
    return max(1, round(HOLD / arena.timing.decision_period))


def _touches(frames: FrameColumns) -> tuple[Bools, Bools]:
    """Return who touched a loose pellet, and who touched whom or the same pellet, row by row."""
    rows, robots, count = frames.rows, frames.pose.shape[1], frames.contacts
    pressed = np.zeros((rows, robots), dtype=np.bool_)
    linked = np.zeros((rows, robots, robots), dtype=np.bool_)
    if count == 0:
        return pressed, linked
    row, kind = frames.row_of_contact(), frames.contact_kind[:count]
    a, b = frames.contact_pair[:count].T
    between = kind == ContactKind.ROBOT_ROBOT
    linked[row[between], a[between], b[between]] = True
    pellets = kind == ContactKind.ROBOT_PELLET
    row, a, b = row[pellets], a[pellets], b[pellets]
    pressed[row, a] = True
    linked |= linked.transpose(0, 2, 1)
    # Who was at one pellet after one decision; all of them are linked to each other.
    each, which = np.unique(row * frames.pellets.shape[1] + b, return_inverse=True)
    there = np.zeros((len(each), robots), dtype=np.bool_)
    there[which, a] = True
    shared = there.sum(axis=1) > 1
    there, row = there[shared], each[shared] // frames.pellets.shape[1]
    np.logical_or.at(linked, row, there[:, :, None] & there[:, None, :])
    linked &= ~np.eye(robots, dtype=np.bool_)
    return pressed, linked


def _sums(flags: Bools, span: int) -> NDArray[np.int32]:
    """Return how many of the `span` flags up to each row are set, for the rows from number `span` on."""
    sums = np.cumsum(flags, axis=0, dtype=np.int32)
    return np.asarray(sums[span:] - sums[:-span])


def _labelled(link: Bools, pellet: Bools, at_tunnel: Bools) -> Integers:
    """Return the group of each robot, as its lowest member, or -1 for who is in none: [rows, robots].

    Linked robots are a group if one of them is `at_tunnel` [rows, robots], and they are two, or one at a
    `pellet` [rows, robots].
    """
    rows, robots = pellet.shape
    row, one, other = np.nonzero(link)
    # One graph for all rows: robots of different rows are different nodes, and never linked.
    nodes = rows * robots
    edges = (row * robots + one, row * robots + other)
    graph = coo_array((np.ones(len(row), dtype=np.bool_), edges), shape=(nodes, nodes))
    count, part = connected_components(graph, directed=False)
    crowd = np.bincount(part, minlength=count) >= 2
    crowd |= np.bincount(part, pellet.ravel(), count) > 0
    crowd &= np.bincount(part, at_tunnel.ravel(), count) > 0
    lowest = np.unique(part, return_index=True)[1] % robots
    label: Integers = np.where(crowd, lowest, -1)[part]
    return label.reshape(rows, robots)
