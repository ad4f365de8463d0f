"""Lengths of the shortest paths to zones of a cell map, in units of cells.

A shortest path bends only at corners of walls. So the distance at a point is the least of: straight
to the zone, or straight to a corner in sight and on from there (a visibility graph; exact).

The search over corners (Dijkstra) is written out: what it costs is the lines of sight, so scipy's takes as
long, and importing that would slow down the start of every process that makes an environment. scipy has no
fast marching.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from robosim.arena.geometry import rectangles

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WORK = 4e7
"""Tests of a line of sight against a rectangle that an exact raster may cost (about a second)."""
_SLIDE = 1e-9
"""A path may slide along a wall: walls count as this much smaller, in cells."""


def geodesic_raster(free: Mask, zones: tuple[Mask, ...]) -> tuple[Floats, int]:
    """Distances in cells at the nodes of a raster: ([ny, nx, zones], nodes per cell).

    Exact at the nodes while the map is small. Maps with very many corners get the fast marching
    solution on cell centres, a few per cent off.
    """
    corners = _corners(free)
    walls = _sight_blockers(free)
    targets = sum(len(rectangles(zone)) for zone in zones)
    for per_cell in (8, 4, 2):
        rays = free.size * per_cell**2 * (len(corners) + targets)
        if rays * len(walls) <= _WORK:
            values = _exact(free, zones, corners, walls, per_cell)
            break
    else:
        per_cell = 1
        values = np.stack([_nodes_from_cells(_fast_marching(free, zone)) for zone in zones], axis=-1)
    return _extended(values, per_cell), per_cell


def _corners(free: Mask) -> Floats:
    """Points [n, 2] where a path can bend: one wall cell among the four around, as (x, y) in cells."""
    around = np.stack((free[:-1, :-1], free[:-1, 1:], free[1:, :-1], free[1:, 1:])).sum(axis=0)
    rows, columns = np.nonzero(around == 3)
    return np.stack((columns + 1, rows + 1), axis=-1).astype(np.float64)


def _sight_blockers(free: Mask) -> Floats:
    """Rectangles [n, 4] that cover the walls, along rows and along columns both.

    With one tiling alone a ray could slip along the seam of two rectangles. Where two walls touch
    at a corner only, a small square closes the gap, which no robot could pass.
    """
    along_rows = rectangles(~free).astype(np.float64)
    along_columns = rectangles(~free.T)[:, [1, 0, 3, 2]].astype(np.float64)
    a, b, c, d = free[:-1, :-1], free[:-1, 1:], free[1:, :-1], free[1:, 1:]
    rows, columns = np.nonzero((a == d) & (b == c) & (a != b))
    pinches = np.stack((columns + 1, rows + 1, columns + 1, rows + 1), axis=-1) + np.array(
        [-1e-3, -1e-3, 1e-3, 1e-3]
    )
    return np.unique(np.concatenate((along_rows, along_columns, pinches)), axis=0)


def _in_sight(start: Floats, end: Floats, walls: Floats) -> Mask:
    """Whether the straight lines from start [..., 2] to end [..., 2] cross no wall (slab method)."""
    x, y = start[..., 0], start[..., 1]
    delta = end - start
    delta = np.where(delta == 0.0, 1e-300, delta)
    dx, dy = delta[..., 0], delta[..., 1]
    sight = np.ones(dx.shape, dtype=np.bool_)
    for x0, y0, x1, y1 in walls + np.array([_SLIDE, _SLIDE, -_SLIDE, -_SLIDE]):
        tx0, tx1, ty0, ty1 = (x0 - x) / dx, (x1 - x) / dx, (y0 - y) / dy, (y1 - y) / dy
        enter = np.maximum(np.maximum(np.minimum(tx0, tx1), np.minimum(ty0, ty1)), 0.0)
        leave = np.minimum(np.minimum(np.maximum(tx0, tx1), np.maximum(ty0, ty1)), 1.0)
        sight &= leave <= enter
    return sight


def _exact(free: Mask, zones: tuple[Mask, ...], corners: Floats, walls: Floats, per_cell: int) -> Floats:
    rows, columns = free.shape
    grid_y, grid_x = np.mgrid[0 : rows * per_cell + 1, 0 : columns * per_cell + 1] / per_cell
    nodes = np.stack((grid_x, grid_y), axis=-1).reshape(-1, 2)
    of_corner = [_by_corners(_straight(corners, zone, walls), corners, walls) for zone in zones]
    values = np.full((grid_x.size, len(zones)), np.inf)
    open_node = _beside_free(free, per_cell).ravel()
    inside = nodes[open_node]
    best = np.stack([_straight(inside, zone, walls) for zone in zones], axis=-1)
    for index, corner in enumerate(corners):
        step = _stretch(inside, corner, walls)
        for zone in range(len(zones)):
            best[:, zone] = np.minimum(best[:, zone], step + of_corner[zone][index])
    values[open_node] = best
    return values.reshape(*grid_x.shape, len(zones))


def _straight(points: Floats, zone: Mask, walls: Floats) -> Floats:
    """Distances [n] to the nearest zone point in sight, straight; inf where none is."""
    best = np.full(len(points), np.inf)
    for x0, y0, x1, y1 in rectangles(zone):
        nearest = np.clip(points, (x0, y0), (x1, y1))
        best = np.minimum(best, _stretch(points, nearest, walls))
    return best


def _stretch(points: Floats, ends: Floats, walls: Floats) -> Floats:
    """Straight distances [n] from points to ends; inf where a wall is between."""
    length: Floats = np.hypot(*(ends - points).T)
    return np.where(_in_sight(points, ends, walls), length, np.inf)


def _by_corners(straight: Floats, corners: Floats, walls: Floats) -> Floats:
    """Distances [n] of corners to the zone, over other corners where needed (Dijkstra)."""
    best = straight.copy()
    open_corners = np.ones(len(best), dtype=np.bool_)
    for _ in range(len(best)):
        index = int(np.argmin(np.where(open_corners, best, np.inf)))
        if not open_corners[index] or not np.isfinite(best[index]):
            break
        open_corners[index] = False
        best = np.minimum(best, best[index] + _stretch(corners, corners[index], walls))
    return best


def _beside_free(free: Mask, per_cell: int) -> Mask:
    """Find the nodes that lie in a free cell or on its edge."""
    fine = np.repeat(np.repeat(free, per_cell, axis=0), per_cell, axis=1)
    wide = np.pad(fine, 1)
    beside: Mask = wide[:-1, :-1] | wide[:-1, 1:] | wide[1:, :-1] | wide[1:, 1:]
    return beside


def _fast_marching(free: Mask, zone: Mask) -> Floats:
    """Distances from cell centres to the zone's nearest cell centre, less half a cell (Sethian 1996)."""
    rows, columns = free.shape
    stride = columns + 2
    value = [float("inf")] * ((rows + 2) * stride)
    is_free = np.pad(free, 1).ravel().tolist()
    heap: list[tuple[float, int]] = []
    for cell in np.flatnonzero(np.pad(zone, 1)).tolist():
        value[cell] = 0.0
        heap.append((0.0, cell))
    heapq.heapify(heap)
    while heap:
        at, cell = heapq.heappop(heap)
        if at > value[cell]:
            continue
        for near in (cell - 1, cell + 1, cell - stride, cell + stride):
            if not is_free[near]:
                continue
            a = min(value[near - 1], value[near + 1])
            b = min(value[near - stride], value[near + stride])
            one_sided = abs(a - b) >= 1.0
            new = min(a, b) + 1.0 if one_sided else 0.5 * (a + b + (2.0 - (a - b) ** 2) ** 0.5)
            if new < value[near] - 1e-12:
                value[near] = new
                heapq.heappush(heap, (new, near))
    cells = np.array(value).reshape(rows + 2, stride)[1:-1, 1:-1]
    return np.maximum(cells - 0.5, 0.0)


def _nodes_from_cells(cells: Floats) -> Floats:
    """Means of the reached cells around each node; inf where none is."""
    wide = np.pad(cells, 1, constant_values=np.inf)
    around = np.stack((wide[:-1, :-1], wide[:-1, 1:], wide[1:, :-1], wide[1:, 1:]))
    return _mean_of_finite(around)


def _mean_of_finite(values: Floats) -> Floats:
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    count = known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.inf)


def _extended(values: Floats, per_cell: int) -> Floats:
    """Continue the values half a cell and more into the walls, and hold the largest value deeper in."""
    for _ in range(per_cell):
        wide = np.pad(values, ((1, 1), (1, 1), (0, 0)), constant_values=np.inf)
        ny, nx = values.shape[:2]
        around = np.stack([wide[r : r + ny, c : c + nx] for r in range(3) for c in range(3)])
        values = np.where(np.isfinite(values), values, _mean_of_finite(around))
    known = values[np.isfinite(values)]
    return np.where(np.isfinite(values), values, known.max(initial=0.0))
