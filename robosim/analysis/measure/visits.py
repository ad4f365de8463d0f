"""Visits of robots to tunnels: where they came in, how deep they went, and where they left."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.analysis.measure.tunnels import Tunnels

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class End(IntEnum):
    """The ends of a tunnel."""

    NOWHERE = -1
    """The visit began in the tunnel, or was not over when the run was."""
    HOME = 0
    SOURCE = 1


class Visit(NamedTuple):
    """A robot's stay in a tunnel, from the decision that led in to the one that led out."""

    robot: int
    tunnel: int
    start: int
    """First decision after which the robot is inside."""
    end: int
    """First decision after which it no longer is."""
    entered: End
    left: End
    deepest: float
    """How far from the end where it entered it has been, m."""

    @property
    def passage(self) -> bool:
        """Whether the robot came in at one end and left at the other."""
        return self.entered >= 0 and self.left >= 0 and self.entered != self.left

    def is_reversal(self, length: float) -> bool:
        """Whether a robot of `length` m was wholly inside and left where it had come in (Aguilar 2018)."""
        return self.entered >= 0 and self.entered == self.left and self.deepest >= length


@dataclass(slots=True)
class _OpenVisit:
    start: int
    entered: End
    origin: float
    """Distance to home of the end where it began, or of the place, for the visit of a robot put there, m."""
    deepest: float = 0.0


class VisitLog:
    """Takes chunks of rows; between them it keeps the visits that are not over."""

    def __init__(self, tunnels: Tunnels) -> None:
        self._tunnels = tunnels
        self._open: dict[int, _OpenVisit] = {}
        self._inside: Integers | None = None

    def add(self, step: Integers, inside: Integers, distance: Floats) -> list[Visit]:
        """Take in the next rows and return the visits that ended in them.

        `step` is [rows]; `inside`, the tunnel that each robot is in or -1, and `distance` to home in m are
        [rows, robots]. Robots that the first row of all finds in a tunnel have come from nowhere.
        """
        ended: list[Visit] = []
        if self._inside is None:
            self._inside = inside[0].copy()
            for robot in np.flatnonzero(inside[0] >= 0).tolist():
                self._open[robot] = _OpenVisit(int(step[0]), End.NOWHERE, float(distance[0, robot]))
        before, now = np.concatenate([self._inside[None], inside[:-1]]), inside
        self._inside = inside[-1].copy()
        changed = before != now
        for robot in np.flatnonzero(changed.any(axis=0) | (now[-1] >= 0)).tolist():
            at = np.flatnonzero(changed[:, robot]).tolist()
            begin = 0
            tunnel = int(before[0, robot])
            for row in [*at, len(now)]:
                visit = self._open.get(robot)
                if visit is not None and row > begin:
                    away = float(np.abs(distance[begin:row, robot] - visit.origin).max())
                    visit.deepest = max(visit.deepest, away)
                if row == len(now):
                    break
                here = float(distance[row, robot])
                if visit is not None:
                    left = self._nearer_end(tunnel, here)
                    del self._open[robot]
                    ended.append(
                        Visit(robot, tunnel, visit.start, int(step[row]), visit.entered, left, visit.deepest)
                    )
                tunnel = int(now[row, robot])
                if tunnel >= 0:
                    end = self._nearer_end(tunnel, here)
                    origin = float(self._tunnels.home_end[tunnel] + end * self._tunnels.length[tunnel])
                    self._open[robot] = _OpenVisit(int(step[row]), end, origin)
                begin = row
        return ended

    def unfinished(self, end: int) -> list[Visit]:
        """Return the visits that are not over, as if decision `end` were the first one after them."""
        inside = np.zeros(0, dtype=np.int64) if self._inside is None else self._inside
        return [
            Visit(robot, int(inside[robot]), visit.start, end, visit.entered, End.NOWHERE, visit.deepest)
            for robot, visit in sorted(self._open.items())
        ]

    def _nearer_end(self, tunnel: int, distance: float) -> End:
        middle = self._tunnels.home_end[tunnel] + 0.5 * self._tunnels.length[tunnel]
        return End.HOME if distance < middle else End.SOURCE
