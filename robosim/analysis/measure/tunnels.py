"""The tunnels of an arena, and where along them a robot is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.arena.distance import DistanceField
from robosim.arena.geometry import components
from robosim.arena.model import Arena, Zone

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Tunnels:
    """The connected parts of zone T, numbered from 0, with their ends.

    A place along a tunnel is its geodesic distance to home, since a tunnel leads from the side of the home
    to that of the source: it grows from the tunnel's home end to its source end.
    """

    inside: Integers
    """[rows, columns] number of the tunnel that a cell belongs to, or -1."""
    near: Integers
    """[rows, columns] the same, with the mouths: free cells within a robot's length of a tunnel."""
    home_end: Floats
    """[tunnels] distance to home at the end nearer home, m."""
    length: Floats
    """[tunnels] m."""
    transit_time: Floats
    """[tunnels] free-flow transit time: the length at a robot's top speed, s."""
    cell_size: float
    """m."""
    _distances: DistanceField

    @property
    def count(self) -> int:
        """How many tunnels the arena has."""
        return len(self.length)

    def cells(self, place: Floats) -> tuple[Integers, Integers]:
        """Return rows and columns of the cells of places [..., 2] in m."""
        rows, columns = self.inside.shape
        at = np.floor(place * (1.0 / self.cell_size)).astype(np.int64)
        return np.clip(at[..., 1], 0, rows - 1), np.clip(at[..., 0], 0, columns - 1)

    def distance_to_home(self, place: Floats) -> Floats:
        """Return the geodesic distance to home of places [..., 2], m."""
        return np.asarray(self._distances.sample(place)[..., 0])


def find_tunnels(arena: Arena) -> Tunnels:
    """Return the tunnels of `arena`; there may be none."""
    free = arena.zones != Zone.WALL
    inside = components(arena.zones == Zone.TUNNEL)
    count = int(inside.max(initial=-1)) + 1
    near = inside.copy()
    for _ in range(int(np.ceil(arena.robot.length / arena.cell_size))):
        grown = near.copy()
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            # The border of a map is wall, so what rolls over it lands on no free cell.
            grown = np.where((grown < 0) & free, np.roll(near, step, axis), grown)
        near = grown
    home_end, length = np.zeros(count), np.zeros(count)
    for tunnel in range(count):
        rows, columns = np.nonzero(inside == tunnel)
        centres: Floats = (np.stack([columns, rows], axis=-1) + np.float64(0.5)) * arena.cell_size
        distance = arena.distances.sample(centres)[:, 0]
        home_end[tunnel] = distance.min() - 0.5 * arena.cell_size
        length[tunnel] = distance.max() - distance.min() + arena.cell_size
    return Tunnels(
        inside, near, home_end, length, length / arena.robot.top_speed, arena.cell_size, arena.distances
    )
