"""Pictures of a team at one moment of an episode, as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from robosim.analysis.figures.arenas import (
    PELLET_COLOUR,
    ROBOT_COLOUR,
    disc,
    draw_pellets,
    draw_robots,
    draw_zones,
)
from robosim.analysis.figures.rendering import palette_png
from robosim.analysis.figures.style import SERIES
from robosim.arena.model import Arena
from robosim.episodes.frame import Frame
from robosim.equality import EqualByValue
from robosim.files import write_whole
from robosim.world.state import LOOSE

_LADEN_COLOUR = "#c0392b"
_WIDTH, _TITLE, _LEGEND, _GAP = 9.0, 0.35, 0.35, 0.1
"""Inches."""
_DPI, _COLOURS = 110, 64


@dataclass(frozen=True, eq=False)
class Moment(EqualByValue):
    """Where robots and pellets are."""

    title: str
    arena: Arena
    poses: NDArray[np.float64]
    """[robots, 3] x m, y m, heading rad."""
    laden: NDArray[np.bool_]
    """[robots] holds a pellet."""
    pellets: NDArray[np.float64]
    """[pellets, 2] m, those that lie somewhere."""

    @classmethod
    def of(cls, frame: Frame, arena: Arena, title: str) -> Moment:
        """Return the moment of a frame, copied."""
        loose = frame.pellets[frame.pellet_status == LOOSE]
        return cls(title, arena, frame.pose.copy(), frame.laden.copy(), loose.copy())


def save_moments(moments: Sequence[Moment], path: Path) -> None:
    """Draw moments below each other, robots that hold a pellet in red.

    In a mixed team robots have the colour of their group, and with a pellet a line ahead in that of pellets.
    InputError where the file cannot be written.
    """
    heights = [_WIDTH * one.arena.size[1] / one.arena.size[0] for one in moments]
    total = sum(heights) + len(moments) * (_TITLE + _GAP) + _LEGEND
    figure = Figure(figsize=(_WIDTH, total), dpi=_DPI)
    top = total
    for one, height in zip(moments, heights, strict=True):
        top -= _TITLE + height
        axes = figure.add_axes((0.01, top / total, 0.98, height / total))
        draw_zones(axes, one.arena)
        draw_pellets(axes, one.arena, one.pellets)
        _draw_team(axes, one)
        axes.set_title(one.title, loc="left", fontsize=10)
        axes.set_xlim(0.0, one.arena.size[0])
        axes.set_ylim(0.0, one.arena.size[1])
        axes.set_xticks([])
        axes.set_yticks([])
        top -= _GAP
    handles = [*_explained(moments[0].arena), disc("pellet", PELLET_COLOUR, 4)]
    figure.legend(
        handles=handles,
        loc="lower left",
        ncols=len(handles),
        frameon=False,
        fontsize=9,
    )
    write_whole(path, palette_png(figure, _COLOURS))


def _draw_team(axes: Axes, moment: Moment) -> None:
    team = moment.arena.team(len(moment.poses))
    for number in range(len(team.groups)):
        for laden in (False, True):
            shown = np.flatnonzero((team.group == number) & (moment.laden == laden))
            colour, ahead = _LADEN_COLOUR if laden else ROBOT_COLOUR, "white"
            if team.mixed:
                colour, ahead = SERIES[number % len(SERIES)], PELLET_COLOUR if laden else "white"
            draw_robots(axes, [team.sheets[robot] for robot in shown], moment.poses[shown], colour, ahead)


def _explained(arena: Arena) -> list[Line2D]:
    """Return what the legend says of robots."""
    if arena.groups:
        return [
            disc(group.name, SERIES[number % len(SERIES)], 9) for number, group in enumerate(arena.groups)
        ]
    return [disc("robot", ROBOT_COLOUR, 9), disc("robot with a pellet", _LADEN_COLOUR, 9)]
