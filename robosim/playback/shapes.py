"""The shapes that a recording draws, as lines in metres: walls, and robots in their own frame."""

from __future__ import annotations

import numpy as np

from robosim.arena.model import Arena, Zone
from robosim.robot.sheet import RobotSheet

Strip = list[tuple[float, float]]
"""Points (x, y) of a line, m."""


def wall_edges(arena: Arena) -> list[Strip]:
    """Return the lines, in m, between wall cells and all others."""
    wall = np.pad(arena.zones == Zone.WALL, 1, constant_values=True)
    size = arena.cell_size
    edges: list[Strip] = []
    for row, column in np.argwhere(wall[1:, 1:-1] != wall[:-1, 1:-1]):
        edges.append([(column * size, row * size), ((column + 1) * size, row * size)])
    for row, column in np.argwhere(wall[1:-1, 1:] != wall[1:-1, :-1]):
        edges.append([(column * size, row * size), (column * size, (row + 1) * size)])
    return edges


def body_strips(sheet: RobotSheet) -> tuple[list[Strip], float]:
    """Return lines and their radius, m, that together fill the body's outline.

    Lines have round ends, so one of half the width's radius fills a circle or a capsule exactly; a box
    is filled by thinner ones side by side, which rounds its corners by a twelfth of its width.
    """
    if sheet.shape != "box":
        radius = 0.5 * sheet.width
        # A line needs some length to be drawn.
        half = max(0.5 * sheet.length - radius, 1e-4 * radius)
        return [[(-half, 0.0), (half, 0.0)]], radius
    radius = sheet.width / 12
    half = 0.5 * sheet.length - radius
    return [[(-half, float(y)), (half, float(y))] for y in radius * np.arange(-5.0, 6.0)], radius


def gripper(sheet: RobotSheet, pellet_radius: float) -> list[Strip]:
    """Return the two fingers at the nose, m, as far apart as a pellet is wide."""
    finger = max(sheet.gripper_reach, 0.5 * pellet_radius)
    apart = min(pellet_radius, 0.4 * sheet.width)
    nose = 0.5 * sheet.length
    if sheet.shape != "box":
        radius = 0.5 * sheet.width
        nose += (radius**2 - apart**2) ** 0.5 - radius
    end = 0.5 * sheet.length + finger
    return [[(nose, side * apart), (end, side * apart)] for side in (-1.0, 1.0)]
