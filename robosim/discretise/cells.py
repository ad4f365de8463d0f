"""Bodies on the grid: which cell a robot is in, and what lies around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.discretise.goals import distances_of
from robosim.robot.team import Role

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

NEIGHBOURS = np.array([[0, 1], [0, -1], [-1, 0], [1, 0], [-1, 1], [1, 1], [-1, -1], [1, -1]], dtype=np.int64)
"""[8, 2] steps (columns, rows) to the neighbouring cells: N, S, W, E, NW, NE, SW, SE."""


class Grid:
    """The arena's cells, with a border of walls `margin` cells wide, addressed by one flat index."""

    def __init__(self, arena: Arena, margin: int) -> None:
        self.margin = margin
        self.cell_size = arena.cell_size
        self.rows = arena.rows
        self.columns = arena.columns
        self.shape = (arena.rows + 2 * margin, arena.columns + 2 * margin)
        zones = np.pad(arena.zones, margin, constant_values=int(Zone.WALL))
        self.zones: NDArray[np.uint8] = zones.ravel()
        """[cells] zone of every cell of the padded grid."""
        self.free: NDArray[np.bool_] = zones != Zone.WALL
        """[padded rows, padded columns]."""
        self._free_flat = self.free.ravel()
        self.size = int(zones.size)
        self.tunnel_length = max(arena.tunnel_length, 1)
        self._per_length = (self.zones == Zone.TUNNEL) / self.tunnel_length
        self._neighbours = self.flat_steps(NEIGHBOURS)

    def flat_steps(self, steps: Integers) -> Integers:
        """Return steps [n, 2] (columns, rows) as differences [n] of the flat index."""
        return np.asarray(steps[:, 1] * self.shape[1] + steps[:, 0], dtype=np.int64)

    def cell_coordinates(self, positions: Floats) -> Floats:
        """Return positions [..., 2] in units of cells; the whole part is (column, row)."""
        return positions * (1.0 / self.cell_size)

    def flat_index(self, coordinates: Floats) -> Integers:
        """Return the flat index of the cell for coordinates [..., 2] in units of cells."""
        cells = coordinates.astype(np.int64)
        cells += self.margin
        return np.asarray(cells[..., 1] * self.shape[1] + cells[..., 0])

    def free_neighbours(self, cell: Integers) -> NDArray[np.bool_]:
        """Return whether each neighbour of cells [envs, robots] holds neither wall nor robot, [..., 8]."""
        free = np.empty((cell.shape[0], self.size), dtype=np.bool_)
        free[...] = self._free_flat
        start = np.arange(0, free.size, self.size)[:, None]
        flat = free.ravel()
        here = cell + start
        flat[here] = False
        return flat.take(here[..., None] + self._neighbours)

    def tunnel_density(self, cell: Integers) -> Floats:
        """Return robots in the tunnel per cell of its length, n / L, for cells [envs, robots]; [envs]."""
        return np.asarray(self._per_length.take(cell).sum(axis=1))


def gain_table(grid: Grid, arena: Arena, role: Role = Role.ALL_ROUND) -> Floats:
    """Return how much nearer a cell's neighbours are to the goals of a role, [cells, 8], in cells, -1 to 1.

    To where pellets are brought for the neighbours N, S, W and E, then to where they are taken; a wall
    counts as -1.
    """
    rows, columns = np.indices(grid.shape) - grid.margin
    centres: Floats = (np.stack([columns, rows], axis=-1) + np.float64(0.5)) * grid.cell_size
    distance = distances_of(role, arena, centres) * (1.0 / grid.cell_size)
    distance[~grid.free] = np.inf
    flat = distance.reshape(-1, 2)
    table = np.full((grid.size, 2, 4), -1.0)
    cells = np.flatnonzero(grid.free)
    around = cells[:, None] + grid.flat_steps(NEIGHBOURS[:4])
    gained = flat[cells][:, None] - flat[around]
    table[cells] = np.clip(gained, -1.0, 1.0).swapaxes(1, 2)
    return table.reshape(-1, 8)
