"""Plain geometry on cell maps: rectangles, connected parts, room for discs, length of a tunnel.

Connected parts are labelled here and not by scipy.ndimage: on the arenas that ship that would save less than
a millisecond, and importing it would make the start of every process with an environment half as long again.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Cell = tuple[int, int]
"""(row, column)"""

_STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1))


def rectangles(mask: Mask) -> NDArray[np.int64]:
    """Cut the True cells into rectangles [n, 4] of (column0, row0, column1, row1), ends excluded.

    Runs along a row that repeat in the rows above are one rectangle, so each maximal run along a
    row lies in one rectangle whole.
    """
    found: list[tuple[int, int, int, int]] = []
    growing: dict[tuple[int, int], int] = {}
    rows = int(mask.shape[0])
    for row in range(rows + 1):
        runs = set(_runs(mask[row])) if row < rows else set()
        for run in sorted(growing.keys() - runs):
            found += [(run[0], growing.pop(run), run[1], row)]
        for run in runs - growing.keys():
            growing[run] = row
    return np.array(found, dtype=np.int64).reshape(-1, 4)


def _runs(line: Mask) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], line, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def components(free: Mask) -> NDArray[np.int64]:
    """Label the parts of the free cells that are connected over edges: [rows, columns], -1 elsewhere."""
    label = np.full(free.shape, -1, dtype=np.int64)
    count = 0
    for cell in _cells(free):
        if label[cell] < 0:
            for reached in _walk(free, [cell]):
                label[reached] = count
            count += 1
    return label


def tunnel_length(tunnel: Mask, free: Mask) -> int:
    """Length of the longest tunnel along its axis, in cells; 0 without one.

    Counted in layers of cells from a mouth, where the tunnel touches other free cells; so a wide
    tunnel counts once, and a bend counts along the middle.
    """
    mouths = _beside(free & ~tunnel) & tunnel
    longest = 0
    seen: set[Cell] = set()
    for cell in _cells(mouths):
        if cell in seen:
            continue
        steps = _walk(tunnel, list(_walk(mouths, [cell])))
        seen.update(steps)
        farthest = [end for end in steps if mouths[end]][-1]
        steps = _walk(tunnel, list(_walk(mouths, [farthest])))
        longest = max(longest, max(steps.values()) + 1)
    return longest


def passage(free: Mask, home: Mask, source: Mask, cells: int) -> Mask:
    """Find the cells that a free square of `cells` x `cells` covers on its paths from home to the source."""
    covered = np.zeros_like(free)
    if cells > min(free.shape):
        return covered
    windows = [sliding_window_view(mask, (cells, cells)) for mask in (free, home, source)]
    label = components(np.asarray(windows[0].all(axis=(2, 3))))
    at_home, at_source = (np.unique(label[window.any(axis=(2, 3))]) for window in windows[1:])
    joined = np.intersect1d(at_home, at_source)
    passing = np.isin(label, joined[joined >= 0])
    rows, columns = passing.shape
    for row in range(cells):
        for column in range(cells):
            covered[row : row + rows, column : column + columns] |= passing
    return covered


def _beside(mask: Mask) -> Mask:
    wide = np.pad(mask, 1)
    beside: Mask = wide[2:, 1:-1] | wide[:-2, 1:-1] | wide[1:-1, 2:] | wide[1:-1, :-2]
    return beside


def _cells(mask: Mask) -> list[Cell]:
    return [(int(row), int(column)) for row, column in np.argwhere(mask)]


def _walk(free: Mask, begin: list[Cell]) -> dict[Cell, int]:
    """Count steps over edges from the nearest cell of `begin` to each cell in reach, nearest first."""
    steps = dict.fromkeys(begin, 0)
    queue = deque(begin)
    rows, columns = free.shape
    while queue:
        row, column = queue.popleft()
        for down, right in _STEPS:
            cell = row + down, column + right
            inside = 0 <= cell[0] < rows and 0 <= cell[1] < columns
            if inside and cell not in steps and free[cell]:
                steps[cell] = steps[row, column] + 1
                queue.append(cell)
    return steps


def disc_places(
    zone: Mask, wall: Mask, cell_size: float, radius: float, spacing: float, limit: int
) -> NDArray[np.float64]:
    """Places [n, 2] in m, in zone cells, where discs lie clear of walls and of each other.

    A square lattice of at least `spacing`, spread over the zone; at most about `limit` places.
    """
    parts = rectangles(zone).astype(np.float64) * cell_size
    if len(parts) == 0:
        return np.zeros((0, 2))
    spacing = max(spacing, math.sqrt(int(zone.sum()) / limit) * cell_size)
    axes = []
    for axis in (0, 1):
        low, high = float(parts[:, axis].min()), float(parts[:, axis + 2].max())
        beside = _zone_ends_at_wall(zone, wall, axis)
        low += radius if beside[0] else 0.0
        high -= radius if beside[1] else 0.0
        if high < low:
            return np.zeros((0, 2))
        count = int((high - low) / spacing + 1e-9) + 1
        axes.append(np.linspace(low, high, count) if count > 1 else np.array([0.5 * (low + high)]))
    blocks = []
    for x0, y0, x1, y1 in parts:
        x = _between(axes[0], x0, x1)
        y = _between(axes[1], y0, y1)
        blocks.append(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    places = np.concatenate(blocks)
    places = places[clear_of_walls(places, radius * (1 - 1e-9), wall, cell_size)]
    return places[np.lexsort((places[:, 0], places[:, 1]))]


def _between(sorted_values: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """Values in [low, high), and the last one also at `high`: each falls to one of adjoining parts."""
    side: Literal["left", "right"] = "right" if high >= sorted_values[-1] else "left"
    return sorted_values[np.searchsorted(sorted_values, low) : np.searchsorted(sorted_values, high, side)]


def _zone_ends_at_wall(zone: Mask, wall: Mask, axis: int) -> tuple[bool, bool]:
    lines = np.flatnonzero(zone.any(axis=axis))
    walls = np.moveaxis(wall, 1 - axis, 0)
    zones = np.moveaxis(zone, 1 - axis, 0)
    first, last = int(lines[0]), int(lines[-1])
    return bool((walls[first - 1] & zones[first]).any()), bool((walls[last + 1] & zones[last]).any())


def clear_of_walls(
    points: NDArray[np.float64], radius: float, wall: Mask, cell_size: float
) -> NDArray[np.bool_]:
    """Whether discs at points [n, 2] in m touch no wall cell: bool [n]. Outside the map all is wall."""
    reach = int(radius / cell_size) + 1
    solid = np.pad(wall, reach, constant_values=True)
    cell = np.floor(points / cell_size).astype(np.int64)
    clear = np.ones(len(points), dtype=np.bool_)
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            row, column = cell[:, 1] + down, cell[:, 0] + right
            x = points[:, 0] - np.clip(points[:, 0], column * cell_size, (column + 1) * cell_size)
            y = points[:, 1] - np.clip(points[:, 1], row * cell_size, (row + 1) * cell_size)
            near = (x * x + y * y < radius * radius) | ((down == 0) & (right == 0))
            r = np.clip(row + reach, 0, solid.shape[0] - 1)
            c = np.clip(column + reach, 0, solid.shape[1] - 1)
            clear &= ~(near & solid[r, c])
    return clear
