"""What stands still in a recording: the arena, the robots' shapes, names and colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.arena.outline import body_outline
from robosim.playback import entities, palette
from robosim.playback.sending import Stream
from robosim.playback.shapes import Strip, body_strips, gripper, wall_edges
from robosim.robot.sheet import RobotSheet
from robosim.robot.team import Team

# Lower is drawn first; rerun's own defaults put images under lines under points.
_MAP, _PHEROMONE, _EDGE, _TRACK, _PELLET = -30.0, -20.0, 0.0, 5.0, 10.0
_RING, _ROBOT, _MARK, _LINK, _CONTACT = 15.0, 20.0, 30.0, 35.0, 40.0

PHEROMONE_LEVELS = 64
"""Shades of the pheromone map; level 0 is not drawn."""

_CONTRAST = 3.0


def send_scene(stream: Stream, arena: Arena, robots: int, *, rewards: bool = True) -> None:
    """Send everything that does not change: arena, robot shapes, legend, styles of the plots."""
    team = arena.team(robots)
    send_stage(stream, arena, team)
    send_legend(stream, palette.legend(team))
    _send_meetings(stream, arena)
    _send_series(stream, team, rewards=rewards)


def send_stage(stream: Stream, arena: Arena, team: Team) -> None:
    """Send the arena, and the robots' shapes, names and colours of their modes."""
    _send_arena(stream, arena, team)
    for robot, colour in enumerate(palette.heading_colours(team)):
        _send_robot(stream, arena, robot, team.sheets[robot], colour)


def _send_arena(stream: Stream, arena: Arena, team: Team) -> None:
    # rerun's y points down and ours up; the 2D view shows the arena from its parent.
    stream.log(entities.ARENA, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
    cell_to_metres = rr.Transform3D(scale=[arena.cell_size, arena.cell_size, 1.0])
    colours = np.array([palette.ZONES[zone].colour for zone in Zone], dtype=np.uint8)
    stream.log(
        entities.MAP,
        cell_to_metres,
        rr.Image(colours[arena.zones], opacity=1.0, draw_order=_MAP, magnification_filter="nearest"),
        static=True,
    )
    shades = [
        rr.AnnotationInfo(id=level, label=f"occupancy {occupancy:.2f}", color=_pheromone_shade(level))
        for level, occupancy in enumerate(occupancy_of_level(np.arange(PHEROMONE_LEVELS)))
    ]
    stream.log(entities.PHEROMONE, cell_to_metres, rr.AnnotationContext(shades), static=True)
    stream.log(
        entities.PHEROMONE, rr.SegmentationImage.from_fields(opacity=1.0, draw_order=_PHEROMONE), static=True
    )
    stream.log(
        entities.WALLS,
        rr.LineStrips2D(
            wall_edges(arena), colors=palette.OUTLINE, radii=0.03 * arena.cell_size, draw_order=_EDGE
        ),
        static=True,
    )
    places, names = _zone_names(arena)
    stream.log(
        entities.ZONES,
        rr.Points2D(
            places, labels=names, colors=palette.ZONE_NAME, radii=0.0, show_labels=True, draw_order=_EDGE
        ),
        static=True,
    )
    for path, style in ((entities.LOOSE, palette.LOOSE_PELLET), (entities.HELD, palette.HELD_PELLET)):
        stream.log(
            path,
            rr.Points2D.from_fields(colors=style.colour, radii=arena.pellets.radius, draw_order=_PELLET),
            static=True,
        )
    stream.log(
        entities.TRACKS,
        rr.Points2D.from_fields(
            colors=palette.robot_colours(team),
            radii=0.07 * arena.robot.width,
            draw_order=_TRACK,
        ),
        static=True,
    )


def _send_meetings(stream: Stream, arena: Arena) -> None:
    stream.log(
        entities.CLOGS,
        rr.LineStrips2D.from_fields(colors=palette.LINK, radii=0.05 * arena.robot.width, draw_order=_LINK),
        static=True,
    )
    kinds = [rr.AnnotationInfo(kind, style.label, style.colour) for kind, style in palette.CONTACTS.items()]
    stream.log(entities.CONTACTS, rr.AnnotationContext(kinds), static=True)
    stream.log(
        entities.CONTACTS, rr.Points2D.from_fields(show_labels=False, draw_order=_CONTACT), static=True
    )


def _send_robot(stream: Stream, arena: Arena, robot: int, sheet: RobotSheet, colour: palette.Colour) -> None:
    line = 0.035 * sheet.width
    body, radius = body_strips(sheet)
    path = entities.robot(robot)
    stream.log(
        f"{path}/body", rr.LineStrips2D.from_fields(strips=body, radii=radius, draw_order=_ROBOT), static=True
    )
    stream.log(
        f"{path}/outline",
        rr.LineStrips2D.from_fields(
            strips=[body_outline(sheet), *gripper(sheet, arena.pellets.radius)], radii=line, draw_order=_MARK
        ),
        static=True,
    )
    # The inner half of the line lies under the body.
    stream.log(
        entities.ring(robot),
        rr.LineStrips2D.from_fields(colors=palette.CLOG.colour, radii=0.16 * sheet.width, draw_order=_RING),
        static=True,
    )
    nose = 0.5 * sheet.length
    heading: Strip = [(0.15 * nose, 0.0), (0.85 * nose, 0.0)]
    stream.log(
        f"{path}/heading",
        rr.LineStrips2D([heading], colors=colour, radii=1.4 * line, draw_order=_MARK),
        static=True,
    )
    stream.log(
        f"{path}/name",
        rr.Points2D(
            [(0.0, 0.0)],
            labels=str(robot),
            show_labels=True,
            colors=palette.HEADING,
            radii=0.0,
            draw_order=_MARK,
        ),
        static=True,
    )
    styles = palette.MODES.values()
    stream.log(
        entities.mode(robot),
        rr.StateConfiguration(
            values=[style.label for style in styles],
            labels=[style.label for style in styles],
            colors=[style.colour for style in styles],
        ),
        static=True,
    )


def send_legend(stream: Stream, styles: Sequence[palette.Style]) -> None:
    """Send the row of colours and their names below the arena."""
    colours = [style.colour for style in styles]
    swatches = rr.Points2D([(index, 0.0) for index in range(len(styles))], colors=colours, radii=0.07)
    stream.log(entities.SWATCHES, swatches, static=True)
    names = rr.Points2D(
        # A label hangs below its point.
        [(index, 0.07) for index in range(len(styles))],
        labels=[style.label for style in styles],
        colors=colours,
        radii=0.0,
        show_labels=True,
    )
    stream.log(entities.NAMES, names, static=True)


def _send_series(stream: Stream, team: Team, *, rewards: bool) -> None:
    for path, name, steps in (
        (entities.DELIVERED, "pellets, team", True),
        (entities.DENSITY, "tunnel density n/L", True),
        *([(entities.REWARD, "mean reward", False)] if rewards else []),
    ):
        # The viewer would take means of near points, and what holds for long after them would be drawn wrong.
        lines = rr.SeriesLines(
            names=name,
            colors=palette.TEAM,
            widths=2.0,
            interpolation_mode="StepAfter" if steps else "Linear",
            aggregation_policy="Off" if steps else "Average",
        )
        stream.log(path, lines, static=True)
    each = rr.SeriesLines(
        names=[
            f"robot {robot}" + (f", {name}" if team.mixed else "") for robot, name in enumerate(team.names)
        ],
        colors=palette.robot_colours(team),
        interpolation_mode="StepAfter",
        aggregation_policy="Off",
    )
    stream.log(entities.DELIVERED_BY_ROBOT, each, static=True)


def level_of_occupancy(occupancy: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return the shade of an occupancy of any size: level = (levels - 1) (1 - exp(-3 occupancy))."""
    share = -np.expm1(-_CONTRAST * occupancy)
    return np.asarray(np.rint((PHEROMONE_LEVELS - 1) * share), dtype=np.uint8)


def occupancy_of_level(level: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the occupancy that a shade stands for; the darkest stands for all above it too."""
    share: NDArray[np.float64] = np.minimum(level, PHEROMONE_LEVELS - 1.5) / (PHEROMONE_LEVELS - 1)
    return np.asarray(-np.log1p(-share) / _CONTRAST)


def _pheromone_shade(level: int) -> tuple[int, int, int, int]:
    return (*palette.PHEROMONE, round(170 * level / (PHEROMONE_LEVELS - 1)))


def _zone_names(arena: Arena) -> tuple[list[tuple[float, float]], list[str]]:
    width, height = arena.size
    # A name is as high as text is, whatever the arena's scale, and hangs below its point.
    above = max(0.022 * width, 0.085 * height)
    places, names = [], []
    for zone in (Zone.HOME, Zone.SOURCE, Zone.TUNNEL, Zone.HANDOVER):
        cells = np.argwhere(arena.zones == zone)
        if len(cells) == 0:
            continue
        # In the wall above the zone, where robots are not.
        top = cells[:, 0].max()
        column = cells[cells[:, 0] == top, 1].mean() + 0.5
        places.append((float(column * arena.cell_size), float((top + 1) * arena.cell_size) + above))
        names.append(palette.ZONES[zone].label)
    return places, names
