"""The map of an arena with what the robots did there."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from robosim.analysis.figures.style import CLOG_PLACE, INK, PAGE, PAPER, QUIET
from robosim.analysis.measure.metrics import clogs
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.measure.traffic import PER_CELL
from robosim.arena.model import Arena, Zone

Floats = NDArray[np.float64]

_WALL = "#b9bec6"
_LEAST = 0.05
"""Squares with fewer decisions are left white."""
_MOST_PASSES = 8
_HIGHEST = 8.0
"""A map higher than this is drawn at a smaller scale, inches."""
_DECADES = 2.5
"""Shares smaller than the largest by more than this many powers of ten have the palest colour."""


def occupancy(episodes: Sequence[Episode]) -> Figure:
    """Draw in which places robots spend their time, mean over robots and episodes, and where clogs began."""
    arena = episodes[0].arena
    width, height = arena.size
    scale = min((PAGE - 1.2) / width, _HIGHEST / height)
    figure = Figure(figsize=(PAGE, max(1.6, height * scale + 0.85)))
    axes = figure.add_subplot()
    _draw_arena(axes, arena)
    whole = sum(one.decisions * one.robots for one in episodes)
    count = smoothed(np.sum([one.traffic.occupancy for one in episodes], axis=0), arena)
    square = 100.0 * arena.cell_size / PER_CELL
    if count.sum() == 0:
        axes.text(0.5 * width, 0.5 * height, "no decisions were taken", ha="center", color=QUIET)
    else:
        share = np.ma.masked_less(count, _LEAST) / whole
        top = float(share.max())
        image = axes.imshow(
            share,
            norm=LogNorm(top / 10.0**_DECADES, top),
            cmap="magma_r",
            origin="lower",
            extent=(0.0, width, 0.0, height),
            interpolation="nearest",
            zorder=1,
        )
        bar = figure.colorbar(image, ax=axes, extend="min", pad=0.02, shrink=0.9, aspect=14)
        bar.set_label(f"share of the robots' time\nin a square of {square:.3g} cm")
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda part, _: f"{100.0 * part:.4g} %"))
        bar.outline.set_linewidth(0.6)
    places = [clog.place for one in episodes for clog in clogs(one)]
    if places:
        x, y = np.array(places).T
        label = f"where clogs began ({len(places)})"
        axes.scatter(x, y, s=26, marker="o", facecolor="none", edgecolor=PAPER, linewidth=2.0, zorder=4)
        axes.scatter(
            x,
            y,
            s=26,
            marker="o",
            facecolor="none",
            edgecolor=CLOG_PLACE,
            linewidth=1.0,
            zorder=5,
            label=label,
        )
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    return figure


def smoothed(count: NDArray[np.int64], arena: Arena) -> Floats:
    """Spread counts over about what a robot drives in a decision; none goes through walls, and none is lost.

    Robots are seen once a decision. In squares smaller than what they drive in between, those that drive in
    step would leave stripes.
    """
    free = np.kron(arena.zones != Zone.WALL, np.ones((PER_CELL, PER_CELL), dtype=np.bool_))
    spread = count.astype(np.float64)
    squares = arena.robot.top_speed * arena.timing.decision_period * PER_CELL / arena.cell_size
    for _ in range(min(_MOST_PASSES, math.ceil(squares) + 1)):
        for axis in (0, 1):
            # A quarter goes to each free neighbour. The border of a map is wall: nothing rolls over it.
            up = np.where(free & np.roll(free, -1, axis), 0.25 * spread, 0.0)
            down = np.where(free & np.roll(free, 1, axis), 0.25 * spread, 0.0)
            spread = spread - up - down + np.roll(up, 1, axis) + np.roll(down, -1, axis)
    return spread


_ZONE_NAMES = {
    Zone.HOME: "home",
    Zone.SOURCE: "source",
    Zone.TUNNEL: "tunnel",
    Zone.HANDOVER: "hand-over",
}


def _draw_arena(axes: Axes, arena: Arena) -> None:
    width, height = arena.size
    walls = [Rectangle((x0, y0), x1 - x0, y1 - y0) for x0, y0, x1, y1 in arena.walls.tolist()]
    axes.add_collection(PatchCollection(walls, facecolor=_WALL, edgecolor=_WALL, linewidth=0.3, zorder=2))
    for zone, name in _ZONE_NAMES.items():
        _draw_border(axes, arena, zone)
        rows, columns = np.nonzero(arena.zones == zone)
        if len(rows):
            x = (columns.mean() + 0.5) * arena.cell_size
            top = (rows.max() + 1) * arena.cell_size
            axes.text(
                x, min(top + 0.01 * height, height), name, ha="center", va="bottom", color=INK, zorder=6
            )
    axes.set_xlim(0.0, width)
    axes.set_ylim(0.0, height)
    axes.set_aspect("equal")
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)


def _draw_border(axes: Axes, arena: Arena, zone: Zone) -> None:
    """Draw a dotted line around a zone, where it does not end at a wall."""
    inside = arena.zones == zone
    free = arena.zones != Zone.WALL
    size, lines = arena.cell_size, []
    for row, column in zip(*np.nonzero(inside[:, 1:] != inside[:, :-1]), strict=True):
        if free[row, column] and free[row, column + 1]:
            lines.append(([(column + 1) * size] * 2, [row * size, (row + 1) * size]))
    for row, column in zip(*np.nonzero(inside[1:] != inside[:-1]), strict=True):
        if free[row, column] and free[row + 1, column]:
            lines.append(([column * size, (column + 1) * size], [(row + 1) * size] * 2))
    for x, y in lines:
        axes.plot(x, y, color=QUIET, linewidth=0.8, linestyle=(0, (2, 2)), zorder=3)
