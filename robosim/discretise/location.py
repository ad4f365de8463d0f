"""Where robots are on the map, and whether they have moved since the decision before."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.cells import Grid
from robosim.discretise.goals import Goals
from robosim.world.state import Setting

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

TWO_PI = 2.0 * np.pi
BLOCKED_SHARE = 0.25
"""A robot that makes less than this share of its free displacement or turn in a decision hardly moves."""


class Location(NamedTuple):
    """Where the robots of a batch of worlds are."""

    position: Floats
    """[envs, robots, 2] m."""
    heading: Floats
    """[envs, robots] rad."""
    coordinates: Floats
    """[envs, robots, 2] position in units of cells."""
    cell: Integers
    """[envs, robots] flat index in the `Grid`."""
    distances: Floats
    """[envs, robots, 2] to where the robot brings pellets, and to where it takes them, m: to home and source
    for one that does all the work."""


class Locator:
    """Finds robots on the map of one world."""

    def __init__(self, setting: Setting, grid: Grid, goals: Goals) -> None:
        self._grid = grid
        self._distances = goals
        self._least_square = (BLOCKED_SHARE * setting.travel) ** 2
        self._least_turn = BLOCKED_SHARE * setting.turn

    def locate(self, pose: Floats) -> Location:
        """Return where robots at `pose` [envs, robots, 3] are, in arrays of their own."""
        position = pose[..., :2].copy()
        coordinates = self._grid.cell_coordinates(position)
        return Location(
            position,
            pose[..., 2].copy(),
            coordinates,
            self._grid.flat_index(coordinates),
            self._distances.sample(position),
        )

    def hardly_displaced(self, before: Location, now: Location) -> Bools:
        """Return whose displacement is less than `BLOCKED_SHARE` of a free one, [envs, robots]."""
        square = now.position - before.position
        square *= square
        return np.asarray(square[..., 0] + square[..., 1] < self._least_square)

    def hardly_turned(self, before: Location, now: Location) -> Bools:
        """Return whose turn is less than `BLOCKED_SHARE` of one on the spot, [envs, robots]."""
        turn = now.heading - before.heading
        turn = np.abs(turn - TWO_PI * np.rint(turn * (1.0 / TWO_PI)))
        return np.asarray(turn < self._least_turn)
