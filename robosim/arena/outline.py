"""Robots' outlines, and whether they touch each other or walls at given poses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robosim.robot.sheet import RobotSheet

Points = NDArray[np.float64]
Pose = tuple[float, float, float]

_HALF_CIRCLE = 17
"""Points on a half circle; odd, so that a quarter turn ends exactly where a straight side begins."""
_UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def body_outline(sheet: RobotSheet) -> Points:
    """Return the closed outline [n, 2] of a body about its centre, m, the heading along +x."""
    if sheet.shape == "box":
        x, y = 0.5 * sheet.length, 0.5 * sheet.width
        return np.array([(x, y), (-x, y), (-x, -y), (x, -y), (x, y)])
    radius = 0.5 * sheet.width
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _HALF_CIRCLE)
    front = radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    front[:, 0] += 0.5 * sheet.length - radius
    return np.concatenate((front, -front, front[:1]))


def placed(points: Points, pose: Pose) -> Points:
    """Return points [n, 2] of a robot's own frame at a pose, m."""
    x, y, heading = pose
    turn = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
    moved: Points = points @ turn + np.array([x, y])
    return moved


def first_touched(sheets: Sequence[RobotSheet], poses: list[Pose], index: int) -> int | None:
    """Find the first pose before `index` whose robot touches or overlaps the one at `index`.

    `sheets` are the robots' data sheets, one for each pose.
    """
    x, y, _ = poses[index]
    own = sheets[index]
    for other, sheet in enumerate(sheets[:index]):
        apart = math.hypot(poses[other][0] - x, poses[other][1] - y)
        near = apart <= own.outer_radius + sheet.outer_radius
        roundings = _rounding(own) + _rounding(sheet)
        if near and _gap(_core(own, poses[index]), _core(sheet, poses[other])) <= roundings:
            return other
    return None


def touches_wall(sheet: RobotSheet, pose: Pose, wall: NDArray[np.bool_], cell_size: float) -> bool:
    """Whether the outline at a pose touches a wall cell, or leaves the map."""
    x, y, _ = pose
    reach = sheet.outer_radius
    rows, columns = wall.shape
    if not (reach <= x <= columns * cell_size - reach and reach <= y <= rows * cell_size - reach):
        # The border is wall, so this close to the map's end a robot could only stand in it.
        return True
    core = _core(sheet, pose)
    for row in range(int((y - reach) / cell_size), min(int((y + reach) / cell_size) + 1, rows)):
        for column in range(int((x - reach) / cell_size), min(int((x + reach) / cell_size) + 1, columns)):
            if wall[row, column]:
                square = (_UNIT_SQUARE + np.array([column, row])) * cell_size
                if _gap(core, square) <= _rounding(sheet):
                    return True
    return False


def _core(sheet: RobotSheet, pose: Pose) -> Points:
    """Place the convex points [n, 2] that make the outline once grown by the rounding."""
    half, side = 0.5 * sheet.length, 0.5 * sheet.width
    if sheet.shape == "circle":
        body = np.zeros((1, 2))
    elif sheet.shape == "capsule":
        body = np.array([[side - half, 0.0], [half - side, 0.0]])
    else:
        body = np.array([[-half, -side], [half, -side], [half, side], [-half, side]])
    return placed(body, pose)


def _rounding(sheet: RobotSheet) -> float:
    return 0.0 if sheet.shape == "box" else 0.5 * sheet.width


def _gap(a: Points, b: Points) -> float:
    """Distance between two convex outlines of 1, 2 or more points each; 0 where they overlap."""
    if not _separated(a, b):
        return 0.0
    return min(_to_edges(a, b), _to_edges(b, a))


def _separated(a: Points, b: Points) -> bool:
    """Whether a line parallel or square to an edge parts the two (separating axis theorem)."""
    edges = np.concatenate([np.roll(shape, -1, axis=0) - shape for shape in (a, b)])
    axes = np.concatenate((edges, edges[:, ::-1] * np.array([-1.0, 1.0])))
    on_a, on_b = axes @ a.T, axes @ b.T
    parted = (on_a.min(axis=1) > on_b.max(axis=1)) | (on_b.min(axis=1) > on_a.max(axis=1))
    return bool(parted.any()) or (len(a) == 1 and len(b) == 1)


def _to_edges(points: Points, shape: Points) -> float:
    """Least distance of points to the edges of a shape."""
    start, along = shape, np.roll(shape, -1, axis=0) - shape
    length = np.maximum((along**2).sum(axis=1), 1e-300)
    offset = points[:, None] - start[None]
    part = np.clip((offset * along).sum(axis=2) / length, 0.0, 1.0)
    return float(np.hypot(*np.moveaxis(offset - part[..., None] * along, 2, 0)).min())
