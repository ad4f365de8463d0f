"""Pictures of arenas to scale, as PNG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from numpy.typing import NDArray

from robosim.analysis.figures.rendering import palette_png
from robosim.arena.model import Arena, Zone
from robosim.arena.outline import body_outline, placed
from robosim.errors import InputError
from robosim.files import write_whole
from robosim.robot.sheet import RobotSheet

_ZONE_COLOURS = {
    Zone.WALL: "#4a4f57",
    Zone.FLOOR: "#faf9f6",
    Zone.HOME: "#c9e0f4",
    Zone.SOURCE: "#f7ddb0",
    Zone.TUNNEL: "#e4e4e0",
    Zone.HANDOVER: "#ead3e8",
}
ROBOT_COLOUR = "#2b6cb0"
PELLET_COLOUR = "#9c5a1a"

_WIDTH, _LEFT, _RIGHT, _TITLE, _AXIS, _LEGEND = 11.0, 0.5, 0.15, 0.4, 0.3, 0.4
"""Of the picture and its margins, inches."""
_HIGHEST = 60.0
"""A picture higher than this is drawn at a smaller scale, inches."""
_COLUMNS, _FILLED = 5, 0.94
"""Of a gallery: arenas in a row, and the part of its cell that the largest fills."""
_DPI = 110
_COLOURS = 64
"""Of the PNG: flat colours need no more."""


def save_picture(arenas: Sequence[Arena], path: Path) -> None:
    """Draw arenas below each other, all to one scale, with robots and pellets at their places.

    Raises InputError where the file cannot be written; nothing half-written is left.
    """
    _require_png(path)
    write_whole(path, palette_png(_picture(arenas), _COLOURS))


def save_gallery(arenas: Sequence[Arena], path: Path) -> None:
    """Draw the maps of arenas side by side, all to one scale; errors as of `save_picture`."""
    _require_png(path)
    write_whole(path, palette_png(_gallery(arenas), _COLOURS))


def _gallery(arenas: Sequence[Arena]) -> Figure:
    columns = min(_COLUMNS, len(arenas))
    rows = math.ceil(len(arenas) / columns)
    side = max(max(arena.size) for arena in arenas)
    cell = _WIDTH / columns
    total = rows * (cell + _TITLE)
    figure = Figure(figsize=(_WIDTH, total), dpi=_DPI)
    for number, arena in enumerate(arenas):
        row, column = divmod(number, columns)
        width, height = (_FILLED * cell * length / side for length in arena.size)
        left = (column + 0.5) * cell - 0.5 * width
        bottom = total - row * (cell + _TITLE) - _TITLE - 0.5 * (cell + height)
        axes = figure.add_axes((left / _WIDTH, bottom / total, width / _WIDTH, height / total))
        draw_zones(axes, arena)
        axes.set_axis_off()
        axes.set_title(arena.name, fontsize=10)
    return figure


def _require_png(path: Path) -> None:
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: a picture is written as PNG; its name must end in .png.")


def _picture(arenas: Sequence[Arena]) -> Figure:
    scale = (_WIDTH - _LEFT - _RIGHT) / max(arena.size[0] for arena in arenas)
    scale = min(scale, _HIGHEST / sum(arena.size[1] for arena in arenas))
    total = sum(arena.size[1] * scale + _TITLE + _AXIS for arena in arenas) + _LEGEND
    figure = Figure(figsize=(_WIDTH, total), dpi=_DPI)
    top = total
    for arena in arenas:
        width, height = arena.size[0] * scale, arena.size[1] * scale
        top -= _TITLE + height
        box = (_LEFT / _WIDTH, top / total, width / _WIDTH, height / total)
        _draw(figure.add_axes(box), arena)
        top -= _AXIS
    _explain(figure)
    return figure


def draw_zones(axes: Axes, arena: Arena) -> None:
    """Draw what the cells of an arena are."""
    width, height = arena.size
    axes.imshow(
        arena.zones,
        cmap=ListedColormap([_ZONE_COLOURS[zone] for zone in Zone]),
        vmin=0,
        vmax=len(Zone) - 1,
        origin="lower",
        extent=(0.0, width, 0.0, height),
        interpolation="nearest",
    )


def draw_pellets(axes: Axes, arena: Arena, places: NDArray[np.float64]) -> None:
    """Draw pellets at [pellets, 2] m."""
    pellets = [Circle((x, y), arena.pellets.radius) for x, y in places]
    axes.add_collection(PatchCollection(pellets, facecolor=PELLET_COLOUR, linewidth=0))


def draw_robots(
    axes: Axes,
    sheets: Sequence[RobotSheet],
    poses: NDArray[np.float64],
    colour: str,
    ahead: str = "white",
) -> None:
    """Draw robots of data sheets at [robots, 3] x m, y m, heading rad; a line points ahead."""
    robots, noses = [], []
    for sheet, (x, y, heading) in zip(sheets, poses.tolist(), strict=True):
        robots.append(Polygon(placed(body_outline(sheet), (x, y, heading))))
        reach = 0.5 * sheet.length
        noses.append([(x, y), (x + reach * math.cos(heading), y + reach * math.sin(heading))])
    axes.add_collection(PatchCollection(robots, facecolor=colour, linewidth=0))
    axes.add_collection(LineCollection(noses, color=ahead, linewidth=0.8 if ahead == "white" else 2.0))


def _draw(axes: Axes, arena: Arena) -> None:
    width, height = arena.size
    draw_zones(axes, arena)
    taken = np.random.default_rng(0).permutation(len(arena.pellet_places))[: arena.pellets.count]
    draw_pellets(axes, arena, arena.pellet_places[taken])
    headings = [pose[2] for pose in arena.start.poses] or [0.0] * arena.capacity
    places = np.column_stack([arena.start_places, headings])
    draw_robots(axes, arena.team(arena.capacity).sheets, places, ROBOT_COLOUR)
    axes.set_title(
        f"{arena.name}: {width:.2f} x {height:.2f} m, room for {arena.capacity} robots",
        loc="left",
        fontsize=10,
    )
    step = 0.5 if max(width, height) <= 12.0 else 5.0
    axes.set_xticks(np.arange(0.0, width + 1e-9, step))
    axes.set_yticks(np.arange(0.0, height + 1e-9, step))
    axes.tick_params(labelsize=8, length=2)
    axes.set_xlim(0.0, width)
    axes.set_ylim(0.0, height)


def disc(label: str, colour: str, size: float) -> Line2D:
    """Return an entry of a legend for something round."""
    return Line2D([], [], marker="o", linestyle="", color=colour, markersize=size, label=label)


def _explain(figure: Figure) -> None:
    zones = [
        Patch(facecolor=colour, edgecolor="#999999", linewidth=0.5, label=zone.name.lower())
        for zone, colour in _ZONE_COLOURS.items()
    ]
    discs = [disc("robot", ROBOT_COLOUR, 9), disc("pellet", PELLET_COLOUR, 5)]
    figure.legend(
        handles=[*zones, *discs],
        loc="lower left",
        bbox_to_anchor=(_LEFT / _WIDTH, 0.0),
        ncols=len(zones) + len(discs),
        frameon=False,
        fontsize=9,
        borderaxespad=0.3,
    )
