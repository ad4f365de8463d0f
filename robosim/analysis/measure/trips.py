"""Trips: from one delivery of a robot to its next, and what each took."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.discretise.modes import Mode
from robosim.episodes.columns import FrameColumns
from robosim.world.contacts import ContactKind, onsets

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_MODES, _KINDS = len(Mode), len(ContactKind)
_CONTACTS = slice(_MODES, _MODES + _KINDS)
_IMPULSE = _MODES + _KINDS
_ENERGY = _IMPULSE + 1
_TALLIES = _ENERGY + 1


class Trip(NamedTuple):
    """What a robot does from its last delivery, or the start of the run, to a delivery."""

    robot: int
    start: int
    """Decision with which the trip began."""
    end: int
    """Decision that delivered."""
    pellets: int
    """Delivered in that decision: one, or more when a robot pushes others home."""
    seconds: tuple[float, ...]
    """In each `Mode`, s; they add up to the trip's time."""
    contacts: tuple[float, ...]
    """Touches of each `ContactKind` that began during the trip; between robots, they count for both."""
    impulse: float
    """That other robots passed to this one, N s."""
    energy: float
    """Lost at the wheels, J."""


class Totals(NamedTuple):
    """What an episode came to, robot by robot."""

    delivered: Integers
    """[robots] pellets."""
    seconds: Floats
    """[robots, modes] s."""
    contacts: Floats
    """[robots, kinds] touches that began."""
    impulse: Floats
    """[robots] from other robots, N s."""
    energy: Floats
    """[robots] J."""
    closest: Floats
    """[robots] least distance to another robot's centre, m; infinite for one alone, or not metered."""


class TripLog:
    """Takes chunks of frames; between them it keeps one row of sums for each robot.

    A decision's time counts for the mode that it led to.

    A touch is a series of contacts of the same two bodies with no pause longer than a decision. The solver
    gives a contact's impulse for the last substep of each control period; the impulse of the period is taken
    to be as many times that as it has substeps.
    """

    def __init__(self, arena: Arena, robots: int) -> None:
        self._robots = robots
        self._timing = arena.timing
        self._others = max(robots, arena.pellets.count) + 1
        """Robots, or pellets, or one wall, counted from -1 on."""
        self._last_touch: dict[int, float] = {}
        self._sums = np.zeros((robots, _TALLIES))
        self._at_start = np.zeros((robots, _TALLIES))
        self._delivered = np.zeros(robots, dtype=np.int64)
        self._begin = np.zeros(robots, dtype=np.int64)
        self._energy_before = np.zeros(robots)
        self._closest = np.full(robots, np.inf)
        self._begun = False
        self.trips: list[Trip] = []

    def add(self, frames: FrameColumns) -> None:
        """Take in the next rows. The first row of all is the state in which the run begins."""
        rows, first = frames.rows, 0 if self._begun else 1
        if rows:
            self._closest = frames.closest[rows - 1].copy()
        if first:
            self._begun = True
            self._begin[:] = frames.step[0]
            self._delivered = frames.delivered[0].copy()
            self._energy_before = frames.energy[0].copy()
        gained = np.zeros((rows, self._robots, _TALLIES))
        mode = frames.mode[:rows, :, None] == np.arange(_MODES, dtype=np.uint8)
        gained[..., :_MODES] = mode
        # Touches that the run begins with are none of its own, but may go on.
        self._add_contacts(frames, gained)
        if rows == first:
            return
        gained[..., _ENERGY] = np.diff(frames.energy[:rows], axis=0, prepend=self._energy_before[None])
        self._energy_before = frames.energy[rows - 1].copy()
        # A world that knows no forces has no energy to lose, and passes on no impulse, not one of 0.
        np.copyto(gained[..., _IMPULSE], np.nan, where=np.isnan(gained[..., _ENERGY]))
        # One addition after another from the first decision on: how rows are cut into chunks changes no bit.
        gained[first] += self._sums
        sums = np.cumsum(gained[first:], axis=0)
        self._sums = sums[-1].copy()
        delivered = frames.delivered[first:rows]
        more = np.diff(delivered, axis=0, prepend=self._delivered[None])
        self._delivered = delivered[-1].copy()
        step = frames.step[first:rows]
        for row, robot in np.argwhere(more > 0).tolist():
            took = sums[row, robot] - self._at_start[robot]
            self.trips.append(
                Trip(
                    robot=robot,
                    start=int(self._begin[robot]),
                    end=int(step[row]),
                    pellets=int(more[row, robot]),
                    seconds=tuple((took[:_MODES] * self._timing.decision_period).tolist()),
                    contacts=tuple(took[_CONTACTS].tolist()),
                    impulse=float(took[_IMPULSE]),
                    energy=float(took[_ENERGY]),
                )
            )
            self._at_start[robot] = sums[row, robot]
            self._begin[robot] = step[row]

    def totals(self) -> Totals:
        """Return the sums so far, of unfinished trips too."""
        sums = self._sums
        return Totals(
            self._delivered.copy(),
            sums[:, :_MODES] * self._timing.decision_period,
            sums[:, _CONTACTS].copy(),
            sums[:, _IMPULSE].copy(),
            sums[:, _ENERGY].copy(),
            self._closest.copy(),
        )

    def _add_contacts(self, frames: FrameColumns, gained: Floats) -> None:
        count = frames.contacts
        if count == 0:
            return
        row, kind = frames.row_of_contact(), frames.contact_kind[:count]
        a, b = frames.contact_pair[:count].T
        impulse = frames.contact_impulse[:count] * self._timing.substeps
        pair = (a * self._others + b + 1) * _KINDS + kind
        # Within a row contacts are in the order of time; rows follow each other.
        new = onsets(
            pair, frames.contact_time[:count], self._last_touch, 1.001 * self._timing.decision_period
        )
        np.add.at(gained, (row[new], a[new], _MODES + kind[new]), 1.0)
        between = kind == ContactKind.ROBOT_ROBOT
        np.add.at(gained, (row[between], a[between], _IMPULSE), impulse[between])
        np.add.at(gained, (row[between], b[between], _IMPULSE), impulse[between])
        began = between & new
        np.add.at(gained, (row[began], b[began], _MODES + int(ContactKind.ROBOT_ROBOT)), 1.0)
