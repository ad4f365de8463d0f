"""Groups of robots that want to move and cannot, linked by contact, after each decision."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    """[rows, robots] a robot's group, told by its lowest member, or -1."""
    link: Bools
    """[rows, robots, robots] who is linked to whom, within groups; symmetric, False on the diagonal."""
    pellet: Bools
    """[rows, robots] members that pressed on a loose pellet."""


class _Past(NamedTuple):
    """What is remembered of rows, for the window that ends in each."""

    place: Floats
    """[rows, robots, 2] m."""
    moving: Bools
    """[rows, robots] was told to move."""
    touched: Bools
    """[rows, robots] was in touch with something."""
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
        self._still = 0.5 * arena.robot.length
        nobody = np.zeros((self.hold, robots), dtype=np.bool_)
        # Before the run everybody was elsewhere: nobody is held up in its first decisions.
        nowhere = np.full((self.hold, robots, 2), np.inf)
        self._past = _Past(nowhere, nobody, nobody, nobody, np.zeros((self.hold, robots, robots), np.bool_))

    def find(self, frames: FrameColumns) -> Groups:
        """Return the groups of the next rows."""
        hold, place = self.hold, frames.pose[: frames.rows, :, :2]
        touched, pressed, linked = _touches(frames)
        past = self._past
        rows = _Past(
            np.concatenate([past.place, place]),
            np.concatenate([past.moving, frames.action[: frames.rows] != STOP]),
            np.concatenate([past.touched, touched]),
            np.concatenate([past.pressed, pressed]),
            np.concatenate([past.linked, linked]),
        )
        # Copies, so that the whole chunk is not kept alive by its last rows.
        self._past = _Past(
            rows.place[-hold:].copy(),
            rows.moving[-hold:].copy(),
            rows.touched[-hold:].copy(),
            rows.pressed[-hold:].copy(),
            rows.linked[-hold:].copy(),
        )
        way = place - rows.place[: len(place)]
        held = way[..., 0] ** 2 + way[..., 1] ** 2 < self._still**2
        held &= 2 * _sums(rows.moving, hold) >= hold
        held &= _sums(rows.touched, hold) > 0
        pellet = held & (_sums(rows.pressed, hold) > 0)
        both = held[:, :, None] & held[:, None, :]
        link = (_sums(rows.linked, hold) > 0) & both
        same = _reachable(link) & both
        cell_row, cell_column = self._tunnels.cells(place)
        at_tunnel = self._tunnels.near[cell_row, cell_column] >= 0
        valid = (same.sum(axis=2) >= 2) | (same & pellet[:, None, :]).any(axis=2)
        valid &= (same & at_tunnel[:, None, :]).any(axis=2)
        label = np.where(valid, same.argmax(axis=2), -1)
        return Groups(label, link & valid[:, :, None], pellet & valid)


def hold_decisions(arena: Arena) -> int:
    """Return how many decisions it takes to see that robots stand, or that they no longer do: `HOLD`."""
    return max(1, round(HOLD / arena.timing.decision_period))


def _touches(frames: FrameColumns) -> tuple[Bools, Bools, Bools]:
    """Return who touched anything, who a loose pellet, and who whom or the same pellet, row by row."""
    rows, robots, count = frames.rows, frames.pose.shape[1], frames.contacts
    touched = np.zeros((rows, robots), dtype=np.bool_)
    pressed = np.zeros((rows, robots), dtype=np.bool_)
    linked = np.zeros((rows, robots, robots), dtype=np.bool_)
    if count == 0:
        return touched, pressed, linked
    row, kind = frames.row_of_contact(), frames.contact_kind[:count]
    a, b = frames.contact_pair[:count].T
    touched[row, a] = True
    between = kind == ContactKind.ROBOT_ROBOT
    touched[row[between], b[between]] = True
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
    return touched, pressed, linked


def _sums(flags: Bools, span: int) -> NDArray[np.int32]:
    """Return how many of the `span` flags up to each row are set, for the rows from number `span` on."""
    sums = np.cumsum(flags, axis=0, dtype=np.int32)
    return np.asarray(sums[span:] - sums[:-span])


def _reachable(link: Bools) -> Bools:
    """Return who hangs together with whom over any number of links, oneself included, row by row."""
    robots = link.shape[1]
    reach = link | np.eye(robots, dtype=np.bool_)
    if not link.any():
        return reach
    # Only the rows with links need it; a product of counts is an `any` over ways of twice the length.
    rows = np.flatnonzero(link.any(axis=(1, 2)))
    part = reach[rows].astype(np.float32)
    for _ in range(max(1, int(np.ceil(np.log2(robots))))):
        part = np.minimum(part @ part, 1.0)
    reach[rows] = part > 0.0
    return reach
