"""Geodesic distances to home and source: lengths of the shortest paths through free cells, round corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.arena.geodesic import geodesic_raster

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DistanceField:
    """Distances to zones, such as home and source, on a raster, read bilinearly.

    The raster's nodes lie on the lines between cells too, so each of its squares is in one cell
    and no value of the far side of a wall mixes in.
    """

    raster: Floats
    """[ny, nx, zones] distance in m to each zone at the nodes, row 0 at the bottom."""
    spacing: float
    """Between nodes, m."""
    _scale: float
    _last: Floats
    _stride: int
    _table: Floats

    def sample(self, xy: Floats) -> Floats:
        """Distances [..., zones] in m at points xy [..., 2] in m.

        A point beyond the map takes the value at its edge. Each point's value has the same bits
        in every batch.
        """
        at = np.minimum(np.maximum(xy * self._scale, 0.0), self._last)
        node = at.astype(np.int64)
        part = at - node
        x, y = part[..., 0:1], part[..., 1:2]
        value = self._table.take(node[..., 1] * self._stride + node[..., 0], axis=0, mode="clip")
        distances: Floats = (
            value[..., 0, :] + x * value[..., 1, :] + y * (value[..., 2, :] + x * value[..., 3, :])
        )
        return distances


def distance_field(
    free: NDArray[np.bool_], home: NDArray[np.bool_], source: NDArray[np.bool_], cell_size: float
) -> DistanceField:
    """Compute the distances to home and source for a map of cells [rows, columns], row 0 at the bottom."""
    return distances_to((home, source), free, cell_size)


def distances_to(
    zones: tuple[NDArray[np.bool_], ...], free: NDArray[np.bool_], cell_size: float
) -> DistanceField:
    """Compute the distances to each of `zones` for a map of cells [rows, columns], row 0 at the bottom."""
    raster, per_cell = geodesic_raster(free, zones)
    raster *= cell_size
    corner, right, up, both = raster[:-1, :-1], raster[:-1, 1:], raster[1:, :-1], raster[1:, 1:]
    table = np.stack((corner, right - corner, up - corner, both - up - right + corner), axis=2)
    ny, nx = table.shape[:2]
    raster.setflags(write=False)
    return DistanceField(
        raster=raster,
        spacing=cell_size / per_cell,
        _scale=per_cell / cell_size,
        _last=np.nextafter(np.array([nx, ny], dtype=np.float64), 0.0),
        _stride=nx,
        _table=np.ascontiguousarray(table.reshape(-1, 4, len(zones))),
    )
