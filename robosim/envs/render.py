"""Pictures of an environment as arrays of pixels, drawn in numpy alone: the same bits on every machine."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.arena.picture import ZONE_COLOURS, Colour
from robosim.episodes.frame import Frame
from robosim.errors import refused, shown
from robosim.robot.sheet import RobotSheet
from robosim.world.state import PelletStatus

Pixels = NDArray[np.uint8]
_Canvas = NDArray[np.float32]
_Floats = NDArray[np.float64]
_Scalar = TypeVar("_Scalar", bound=np.generic)

# Blue goes out for a pellet, green comes home with one, and red is what should not be.
MODES: tuple[Colour, ...] = (
    (29, 105, 214),
    (140, 66, 201),
    (132, 204, 90),
    (22, 137, 62),
    (235, 190, 20),
    (104, 184, 246),
    (222, 32, 38),
)
"""In the order of `robosim.discretise.modes.Mode`."""
LOOSE_PELLET: Colour = (121, 85, 58)
HELD_PELLET: Colour = (255, 128, 0)
OUTLINE: Colour = (24, 26, 32)
HEADING: Colour = (255, 255, 255)
PHEROMONE: Colour = (84, 40, 150)

RENDER_MODES = ["human", "rgb_array"]
"""A window on the screen, or an array of pixels."""
LONG_SIDE = 960
"""Pixels along the longer side of a picture, about: a cell is a whole number of pixels."""
_PHEROMONE_STRENGTH = 0.6
"""Opacity of a cell with endless pheromone."""
_OUTLINE_WIDTH = 0.09
"""Width of a robot's outline, as a part of the robot's width."""


class Painter:
    """Draws frames of one arena; the empty arena is drawn once, for the first picture, and kept.

    Pictures are about `long_side` pixels long, and of even size, as films must be.
    """

    def __init__(self, arena: Arena, long_side: int = LONG_SIDE) -> None:
        self._arena = arena
        self._cell_pixels = max(4, 2 * round(0.5 * long_side / max(arena.rows, arena.columns)))
        self._scale = self._cell_pixels / arena.cell_size
        """Pixels per metre."""

    @cached_property
    def _background(self) -> _Canvas:
        # Some megabytes, which an environment that nobody looks at need not hold.
        return _empty_arena(self._arena, self._cell_pixels)

    def draw(self, frame: Frame) -> Pixels:
        """Return the picture [height, width, 3]; north is up.

        The floor is tinted by the pheromone, robots have the colour of their mode and a white line
        toward their nose, held pellets differ in colour from loose ones.
        """
        canvas = self._background.copy()
        self._tint(canvas, frame.pheromone)
        self._draw_pellets(canvas, frame, PelletStatus.LOOSE, LOOSE_PELLET)
        sheets = self._arena.team(len(frame.pose)).sheets
        for sheet, pose, mode in zip(sheets, frame.pose, frame.mode, strict=True):
            self._draw_robot(canvas, sheet, pose, MODES[int(mode)])
        self._draw_pellets(canvas, frame, PelletStatus.HELD, HELD_PELLET)
        return np.rint(canvas).astype(np.uint8)

    def _tint(self, canvas: _Canvas, pheromone: _Floats) -> None:
        opacity = np.where(self._arena.zones == Zone.WALL, 0.0, pheromone / (1.0 + pheromone))
        opacity = _to_pixels(_PHEROMONE_STRENGTH * opacity, self._cell_pixels)[..., None]
        canvas += opacity.astype(np.float32) * (np.array(PHEROMONE, dtype=np.float32) - canvas)

    def _draw_pellets(self, canvas: _Canvas, frame: Frame, status: PelletStatus, colour: Colour) -> None:
        """Draw all pellets of one status at once, as discs with soft edges."""
        centres = self._to_picture(frame.pellets[frame.pellet_status == status])
        radius = self._arena.pellets.radius * self._scale
        reach = int(np.ceil(radius)) + 1
        steps = np.arange(-reach, reach + 1)
        rows = np.floor(centres[:, 1]).astype(np.int64)[:, None, None] + steps[:, None]
        columns = np.floor(centres[:, 0]).astype(np.int64)[:, None, None] + steps[None, :]
        away = np.hypot(
            rows + 0.5 - centres[:, 1, None, None],
            columns + 0.5 - centres[:, 0, None, None],
        )
        opacity = np.clip(radius - away + 0.5, 0.0, 1.0)
        rows, columns = np.broadcast_arrays(rows, columns)
        height, width = canvas.shape[:2]
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        cover = np.zeros((height, width))
        np.maximum.at(cover, (rows[inside], columns[inside]), opacity[inside])
        # The rest of the picture, nearly all of it, stays as it is.
        covered = np.nonzero(cover)
        patch = canvas[covered]
        _paint(patch, cover[covered], colour)
        canvas[covered] = patch

    def _draw_robot(self, canvas: _Canvas, sheet: RobotSheet, pose: _Floats, colour: Colour) -> None:
        x, y = self._to_picture(pose[None, :2])[0]
        reach = sheet.outer_radius * self._scale + 2.0
        height, width = canvas.shape[:2]
        top, bottom = np.clip([int(y - reach), int(y + reach) + 1], 0, height)
        left, right = np.clip([int(x - reach), int(x + reach) + 1], 0, width)
        patch = canvas[top:bottom, left:right]
        east = (np.arange(left, right) + 0.5 - x)[None, :] / self._scale
        north = (y - np.arange(top, bottom) - 0.5)[:, None] / self._scale
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        forward, sideways = cosine * east + sine * north, cosine * north - sine * east
        body = outline_distance(sheet, forward, sideways)
        line = 0.5 * _OUTLINE_WIDTH * sheet.width
        nose = np.hypot(forward - np.clip(forward, 0.0, 0.36 * sheet.length), sideways) - line
        _paint(patch, self._opacity(body), OUTLINE)
        _paint(patch, self._opacity(body + _OUTLINE_WIDTH * sheet.width), colour)
        _paint(patch, self._opacity(nose), HEADING)

    def _opacity(self, distance: _Floats) -> _Floats:
        """Return 1 inside a shape, 0 outside, and what is between on the pixels of its edge."""
        return np.clip(0.5 - distance * self._scale, 0.0, 1.0)

    def _to_picture(self, places: _Floats) -> _Floats:
        """Return [n, 2] pixels (right, down) of [n, 2] metres (east, north)."""
        return np.stack(
            [
                places[:, 0] * self._scale,
                self._arena.rows * self._cell_pixels - places[:, 1] * self._scale,
            ],
            axis=1,
        )


def outline_distance(sheet: RobotSheet, forward: _Floats, sideways: _Floats) -> _Floats:
    """Return the distance in m of points to a robot's outline, negative inside.

    Points are given in the robot's own frame, in m; a circle is a capsule as long as wide.
    """
    if sheet.shape == "box":
        along = np.abs(forward) - 0.5 * sheet.length
        across = np.abs(sideways) - 0.5 * sheet.width
        outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(along, across), 0.0))
    half = max(0.0, 0.5 * (sheet.length - sheet.width))
    return np.asarray(np.hypot(forward - np.clip(forward, -half, half), sideways) - 0.5 * sheet.width)


def render_metadata(arena: Arena) -> dict[str, Any]:
    """Return what Gymnasium and PettingZoo ask of an environment that draws: modes, and pictures a second."""
    return {"render_modes": RENDER_MODES, "render_fps": 1.0 / arena.timing.decision_period}


def checked_render_mode(mode: str | None, metadata: Mapping[str, Any]) -> str | None:
    """Return `mode`; raises InputError when it is neither None nor one of the metadata's."""
    if mode is not None and not (isinstance(mode, str) and mode in metadata["render_modes"]):
        allowed = " or ".join(map(shown, metadata["render_modes"]))
        raise refused("render_mode", mode, f"None or {allowed}")
    return mode


def _empty_arena(arena: Arena, cell_pixels: int) -> _Canvas:
    colours = np.zeros((len(Zone), 3), dtype=np.float32)
    for zone in Zone:
        colours[zone] = ZONE_COLOURS[zone]
    canvas = colours[_to_pixels(arena.zones, cell_pixels)]
    # A faint grid lets one count cells.
    floor = _to_pixels(arena.zones != Zone.WALL, cell_pixels)
    rows, columns = np.ogrid[: canvas.shape[0], : canvas.shape[1]]
    on_line = floor & ((rows % cell_pixels == 0) | (columns % cell_pixels == 0))
    canvas[on_line] *= 0.96
    return canvas


def _to_pixels(cells: NDArray[_Scalar], cell_pixels: int) -> NDArray[_Scalar]:
    return cells[::-1].repeat(cell_pixels, axis=0).repeat(cell_pixels, axis=1)


def _paint(canvas: _Canvas, opacity: _Floats, colour: Colour) -> None:
    canvas += opacity[..., None].astype(np.float32) * (np.array(colour, dtype=np.float32) - canvas)
