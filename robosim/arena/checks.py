"""What must hold in an arena file beyond the range of each value: mistakes as sentences.

Each function returns the sentences, without the file's name; none when all is well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from robosim.arena.geometry import Mask, components, passage
from robosim.arena.model import ZONE_OF_CHARACTER, PelletSheet, Randomisation, Start, Timing, Zone
from robosim.arena.outline import first_touched, touches_wall
from robosim.errors import shown
from robosim.robot.sheet import RobotSheet
from robosim.robot.team import Group

MOST_CELLS = 200
"""In a row or a column of the map."""
MOST_SUBSTEPS = 5000
"""In a decision."""
MOST_WORK = 1_000_000
"""Substeps of a decision times bodies: so many take up to half a second where all are in motion."""
MOST_TURN = 0.25
"""Of a robot in a substep, rad."""
_GOAL_NAMES = {Zone.HOME: "home", Zone.SOURCE: "the source", Zone.HANDOVER: "the hand-over"}
SPARE = 0.9
"""Part of the pellet places that the pellets may fill: a fresh pellet needs a free one."""


def drawing_mistakes(lines: list[str]) -> Iterator[str]:
    """Check that the rows of the map are a rectangle of known characters within a closed border."""
    longest = max(map(len, lines))
    if len(lines) > MOST_CELLS or longest > MOST_CELLS:
        yield (
            f"map has {len(lines)} rows and up to {longest} columns, "
            f"but may have at most {MOST_CELLS} of each."
        )
        return
    width = len(lines[0])
    ragged = any(len(line) != width for line in lines)
    for row, line in enumerate(lines, 1):
        if len(line) != width:
            yield f"map row {row} has {len(line)} cells, but row 1 has {width}; all must have as many."
    for row, line in enumerate(lines, 1):
        for column, character in enumerate(line, 1):
            if character not in ZONE_OF_CHARACTER:
                yield (
                    f"map row {row}, column {column} is {shown(character)}, but must be # (wall), . (floor), "
                    "H (home), S (source), T (tunnel) or X (hand-over)."
                )
                break
    if not ragged:
        yield from _border_mistakes(lines)


def _border_mistakes(lines: list[str]) -> Iterator[str]:
    holes = [
        (row, column)
        for row, line in enumerate(lines, 1)
        for column, character in enumerate(line, 1)
        if character in ZONE_OF_CHARACTER
        and character != "#"
        and (row in {1, len(lines)} or column in {1, len(line)})
    ]
    if holes:
        more = f" (and at {len(holes) - 1} more cells)" if len(holes) > 1 else ""
        row, column = holes[0]
        yield f"map has a hole in its border at row {row}, column {column}{more}; it must be # there."


def path_mistakes(zones: NDArray[np.uint8]) -> Iterator[str]:
    """Check that there is a home and a source, and a path between all their cells."""
    names: dict[int, str] = {Zone.HOME: "home (H)", Zone.SOURCE: "source (S)"}
    missing = [name for zone, name in names.items() if not (zones == zone).any()]
    for name in missing:
        yield f"map has no {name} cell, but needs at least one."
    if missing:
        return
    parts = components(zones != Zone.WALL)
    joined = np.intersect1d(parts[zones == Zone.HOME], parts[zones == Zone.SOURCE])
    if len(joined) == 0:
        yield "map has no path from home (H) to the source (S); free cells must join them edge to edge."
        return
    names[Zone.HANDOVER] = "hand-over (X)"
    for zone, name in names.items():
        cut_off = np.argwhere((zones == zone) & (parts != joined[0]))
        if len(cut_off):
            row, column = cut_off[-1]
            yield (
                f"map row {len(zones) - row}, column {column + 1} is {name}, but is cut off by walls; "
                "all home, source and hand-over cells must be joined by free cells."
            )


def group_mistakes(groups: Sequence[Group]) -> Iterator[str]:
    """Check that no two groups have the same name."""
    names = [group.name for group in groups]
    for number, name in enumerate(names):
        if name in names[:number]:
            yield (
                f"groups[{number}].name is {shown(name)}, but must differ from that of "
                f"groups[{names.index(name)}]."
            )


def handover_mistakes(groups: Sequence[Group], zones: NDArray[np.uint8]) -> Iterator[str]:
    """Check that those who hand over have somebody to hand over to, and a place for it."""
    roles = [group.role for group in groups]
    places: dict[str, str] = {
        role: f"groups[{number}].role is {shown(role)}" for number, role in enumerate(roles)
    }
    for role, other, work in (
        ("excavator", "transporter", "brings home what is handed over"),
        ("transporter", "excavator", "hands over"),
    ):
        if role in places and other not in places:
            yield f"{places[role]}, but no group has the role {shown(other)}, which {work}."
    specialists = [place for role, place in places.items() if role != "all-round"]
    if specialists and not (zones == Zone.HANDOVER).any():
        yield f"{specialists[0]}, but the map has no hand-over (X) cell where it could meet the others."


def robot_mistakes(robot: RobotSheet, place: str) -> Iterator[str]:
    """Check that length and width suit the shape."""
    if robot.shape == "circle" and robot.width != robot.length:
        yield f"{place}.width is {robot.width}, but must equal {place}.length ({robot.length}) of a circle."
    elif robot.width > robot.length:
        yield f"{place}.width is {robot.width}, but must be at most {place}.length ({robot.length})."


def timing_mistakes(timing: Timing, pellets: PelletSheet) -> Iterator[str]:
    """Check that periods divide and that a decision does not cost too many substeps."""
    ratio = timing.decision_period / timing.control_period
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        yield (
            f"timing.decision_period is {timing.decision_period}, but must be a whole multiple of "
            f"timing.control_period ({timing.control_period})."
        )
    elif timing.control_steps * timing.substeps > MOST_SUBSTEPS:
        yield (
            f"timing.substeps is {timing.substeps}, but may be at most "
            f"{MOST_SUBSTEPS // timing.control_steps}: "
            f"a decision may have at most {MOST_SUBSTEPS} substeps."
        )
    elif timing.control_steps * timing.substeps * pellets.count > MOST_WORK:
        yield (
            f"pellets.count is {pellets.count}, but may be at most "
            f"{MOST_WORK // (timing.control_steps * timing.substeps)} where a decision has "
            f"{timing.control_steps * timing.substeps} substeps: it would take too long."
        )


def randomisation_mistakes(randomisation: Randomisation) -> Iterator[str]:
    """Check that no range is upside down."""
    for name in Randomisation.__dataclass_fields__:
        low, high = getattr(randomisation, name)
        if low > high:
            yield f"randomisation.{name} is [{low}, {high}], but the first must be at most the second."


def substep_mistakes(
    robot: RobotSheet, pellets: PelletSheet, timing: Timing, randomisation: Randomisation
) -> Iterator[str]:
    """Check that in one substep no robot moves or turns so far that it could pass through things."""
    fastest = robot.top_speed * randomisation.wheel_speed[1]
    turning = robot.top_turn_rate * randomisation.wheel_speed[1]
    longest, reason = min(
        (0.25 * pellets.radius / fastest, f"drives pellets.radius / 4 at its top speed ({fastest:.4g} m/s)"),
        (MOST_TURN / turning, f"turns {MOST_TURN} rad at its top rate ({turning:.4g} rad/s)"),
    )
    if timing.substep > longest * (1 + 1e-9):
        yield (
            f"timing.control_period / timing.substeps is {timing.substep:.4g} s, but must be at most "
            f"{longest:.4g} s, in which a robot {reason}."
        )


def passage_mistakes(
    robot: RobotSheet, place: str, goals: tuple[Zone, Zone], zones: NDArray[np.uint8], cell_size: float
) -> Iterator[str]:
    """Check that a path between the goals of a robot is wider than it is."""
    free, brings, takes = zones != Zone.WALL, zones == goals[0], zones == goals[1]
    cells = cells_wide(robot, cell_size)
    if passage(free, brings, takes, cells).any():
        return
    # A narrower square passes wherever a wider one does.
    widest, too_wide = 1, min(cells, min(free.shape) + 1)
    while too_wide - widest > 1:
        tried = (widest + too_wide) // 2
        if passage(free, brings, takes, tried).any():
            widest = tried
        else:
            too_wide = tried
    from_, to = (_GOAL_NAMES[zone] for zone in goals)
    yield (
        f"{place}.width is {robot.width}, but must be less than {widest * cell_size:.4g} m, the width of "
        f"the widest path from {from_} to {to}."
    )


def cells_wide(robot: RobotSheet, cell_size: float) -> int:
    """How many cells wide a path must be for the robot to pass lengthwise without rubbing."""
    return int(robot.width / cell_size + 1e-9) + 1


def pose_mistakes(
    start: Start, robots: Sequence[RobotSheet], wall: Mask, passable: Sequence[Mask], cell_size: float
) -> Iterator[str]:
    """Check that robots at the given poses touch neither walls nor each other, and can drive on.

    `robots` and `passable`, where they can drive, are those of each pose.
    """
    poses = list(start.poses)
    for index, pose in enumerate(poses):
        text = f"start.poses[{index}] is {shown(list(pose))}, but there the robot "
        if touches_wall(robots[index], pose, wall, cell_size):
            yield f"{text}touches a wall."
        elif not passable[index][int(pose[1] / cell_size), int(pose[0] / cell_size)]:
            yield f"{text}has no path to home and source that is wide enough."
        elif (other := first_touched(robots, poses, index)) is not None:
            yield f"{text}touches that of start.poses[{other}]."


def room_mistakes(
    outer: float, pellets: PelletSheet, start: Start, start_places: int, pellet_places: int
) -> Iterator[str]:
    """Check that at least one robot of that outer radius fits at the start, and all pellets in the source."""
    if start_places == 0:
        yield (
            f"start.zone is {shown(start.zone.name.lower())}, but that zone has no room for a robot that "
            f"turns within {2 * outer:.4g} m."
        )
    most = int(SPARE * pellet_places)
    if pellets.count > most:
        yield (
            f"pellets.count is {pellets.count}, but must be at most {most}: the source (S) has no room for "
            f"more pellets of radius {pellets.radius} m."
        )
