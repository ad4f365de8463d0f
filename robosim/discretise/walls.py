"""Where robots are that are seen in a wall: robots know the map, and nobody takes itself for standing in one.

It needs numpy alone, since it also runs where nothing else of robosim is (`robosim.deploy.robotarium`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_INSIDE = 1e-6
"""How far inside a cell a position on its border is put, in cells."""


def nearest_free(free: Bools) -> NDArray[np.int64]:
    """Return the free cell nearest to each of [rows, columns], as (column, row); itself where it is free.

    Along each column first, then across: exact, and without scipy, whose import would slow every start.
    """
    rows, columns = free.shape
    up, across = np.arange(rows), np.arange(columns)
    row = np.zeros(free.shape, dtype=np.int64)
    square = np.full(free.shape, np.inf)
    for column in np.flatnonzero(free.any(axis=0)):
        there = np.flatnonzero(free[:, column])
        row[:, column] = there[np.abs(up[:, None] - there).argmin(axis=1)]
        square[:, column] = (up - row[:, column]) ** 2
    best = np.stack([((across[:, None] - across) ** 2 + square[one]).argmin(axis=1) for one in up])
    return np.stack([best, np.take_along_axis(row, best, axis=1)], axis=-1)


class Walls:
    """The walls of a map, by its free cells."""

    def __init__(self, free: Bools, cell_size: float) -> None:
        """Take which cells [rows, columns] are free, and their size, m."""
        self._cell_size = cell_size
        self._columns = free.shape[1]
        self._last_cell = np.array([free.shape[1], free.shape[0]]) - 1
        self._nearest_free = nearest_free(free).reshape(-1, 2).astype(np.float64)

    def off(self, position: Floats) -> Floats:
        """Return positions [..., 2] (m) with those in a wall put to the border of the nearest free cell."""
        size = self._cell_size
        cell = np.clip((position * (1.0 / size)).astype(np.int64), 0, self._last_cell)
        free = self._nearest_free.take(cell[..., 1] * self._columns + cell[..., 0], axis=0)
        inside = np.clip(position, (free + _INSIDE) * size, (free + (1.0 - _INSIDE)) * size)
        walled = (free != cell).any(axis=-1, keepdims=True) | (position < 0.0).any(axis=-1, keepdims=True)
        return np.where(walled, inside, position)
