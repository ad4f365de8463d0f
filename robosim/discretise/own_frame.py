"""What lies around a robot in its own frame, for robots that are steered by their wheels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.cells import Grid
from robosim.discretise.goals import Goals
from robosim.discretise.location import Location
from robosim.robot.team import Team

Floats = NDArray[np.float64]

SIDES = ("ahead", "behind", "left", "right", "ahead left", "ahead right", "behind left", "behind right")
_STEPS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [1, -1], [-1, 1], [-1, -1]], dtype=np.float64)
"""[8, 2] cells ahead and to the left, of `SIDES`."""


def turned(apart: Floats, heading: Floats) -> Floats:
    """Return vectors [..., 2] (x, y) as how far ahead and to the left they point, for `heading` [...]."""
    cosine, sine = np.cos(heading), np.sin(heading)
    x, y = apart[..., 0], apart[..., 1]
    return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)


class Surroundings:
    """Looks one cell to each side of robots: whether they could stand there, and what they would gain."""

    def __init__(self, grid: Grid, goals: Goals, team: Team) -> None:
        self._grid = grid
        self._free = grid.free.ravel()
        self._distances = goals
        self._least_square = team.reach[:, None] ** 2
        self._per_cell = 1.0 / grid.cell_size
        self._steps = _STEPS * grid.cell_size

    def look(self, at: Location) -> tuple[NDArray[np.bool_], Floats]:
        """Return what is free, [envs, robots, 8], and gains, [envs, robots, 8], around robots `at` a place.

        Free is a point a cell's length away, in the order of `SIDES`, that is in no wall and so far from each
        other robot's centre that the two would not touch. Gains are how much nearer those ahead, behind, left
        and right are to the home, and then to the source, in cells, -1 to 1; in a wall they are -1.
        """
        cosine, sine = np.cos(at.heading)[..., None], np.sin(at.heading)[..., None]
        ahead, left = self._steps[:, 0], self._steps[:, 1]
        points = np.empty((*at.heading.shape, len(SIDES), 2))
        points[..., 0] = at.position[..., 0, None] + (cosine * ahead - sine * left)
        points[..., 1] = at.position[..., 1, None] + (sine * ahead + cosine * left)
        open_ = self._free.take(self._grid.flat_index(self._grid.cell_coordinates(points)))
        gained = at.distances[..., None, :] - self._distances.sample(points[..., :4, :])
        gained *= self._per_cell
        np.clip(gained, -1.0, 1.0, out=gained)
        gained[~open_[..., :4]] = -1.0
        return open_ & ~self._taken(at.position, points), gained.swapaxes(2, 3).reshape(*open_.shape)

    def _taken(self, position: Floats, points: Floats) -> NDArray[np.bool_]:
        """Return which points [envs, robots, 8, 2] lie too near to another robot, [envs, robots, 8]."""
        robots = position.shape[1]
        apart = points[:, :, :, None, :] - position[:, None, None, :, :]
        apart *= apart
        near = apart[..., 0] + apart[..., 1] < self._least_square
        near[:, np.arange(robots), :, np.arange(robots)] = False
        return np.asarray(near.any(axis=-1))
