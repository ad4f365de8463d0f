"""From the text of an arena file to a checked Arena."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from robosim.arena import checks
from robosim.arena.distance import distance_field, distances_to
from robosim.arena.geometry import disc_places, passage, rectangles, tunnel_length
from robosim.arena.model import (
    GOALS,
    ZONE_OF_CHARACTER,
    Arena,
    PelletSheet,
    Randomisation,
    Start,
    Timing,
    Zone,
)
from robosim.arena.schema import ArenaFile, mistake
from robosim.errors import InputError
from robosim.robot.sheet import RobotSheet
from robosim.robot.team import ROLES, Group, Team
from robosim.texts import parse_toml

_APART = 2.06
"""Least distance of start places and of pellet places, in radii."""
_CLEAR = 1.03
"""Least distance of their centres from walls, in radii."""
_MOST_STARTS = 1000
_MOST_PELLET_PLACES = 5000

Zones = NDArray[np.uint8]
Places = NDArray[np.float64]


def parse_arena(text: str, file: str) -> Arena:
    """Check an arena file's text; `file` is the name that messages use.

    Raises InputError with one sentence per mistake, one on each line.
    """
    table = parse_toml(text, file)
    values, mistakes = _values(table)
    zones, found = _drawn(table.get("map"))
    mistakes += found
    sheets = None if values is None else _sheets(values)
    if sheets is not None:
        mistakes += _sheet_mistakes(sheets)
    if values is None or sheets is None or zones is None:
        raise _refusal(file, mistakes)
    starts, pellets, found = _places(zones, values.cell_size, sheets)
    mistakes += found
    if mistakes:
        raise _refusal(file, mistakes)
    return _assembled(values, sheets, zones, starts, pellets, text, file)


def _refusal(file: str, mistakes: list[str]) -> InputError:
    return InputError("\n".join(f"{file}: {sentence}" for sentence in mistakes))


def _values(table: dict[str, Any]) -> tuple[ArenaFile | None, list[str]]:
    try:
        return ArenaFile.model_validate(table), []
    except ValidationError as error:
        # Parts of one list give the same sentence; it is said once.
        return None, list(dict.fromkeys(mistake(each, table) for each in error.errors()))


def _drawn(drawing: object) -> tuple[Zones | None, list[str]]:
    """Zones [rows, columns] of a map in text, or what is wrong with it."""
    if not isinstance(drawing, str):
        return None, []
    lines = drawing.strip("\n").split("\n")
    mistakes = list(checks.drawing_mistakes(lines))
    if mistakes:
        return None, mistakes
    codes = [[ZONE_OF_CHARACTER[character] for character in line] for line in reversed(lines)]
    zones = np.array(codes, dtype=np.uint8)
    mistakes = list(checks.path_mistakes(zones))
    return (None if mistakes else zones), mistakes


@dataclass(frozen=True, slots=True)
class _Sheets:
    robot: RobotSheet
    groups: tuple[Group, ...]
    pellets: PelletSheet
    timing: Timing
    start: Start
    randomisation: Randomisation

    @property
    def kinds(self) -> list[_Kind]:
        """The kinds of robots that there are: the groups', or the one of a team of equals."""
        if not self.groups:
            return [_Kind("robot", Group("robots", self.robot))]
        return [_Kind(f"groups[{number}].robot", group) for number, group in enumerate(self.groups)]

    def team(self, robots: int) -> Team:
        return Team.dealt(tuple(kind.group for kind in self.kinds), robots)


class _Kind(NamedTuple):
    """Robots that are alike, and the name of the table that holds their data sheet."""

    place: str
    group: Group

    @property
    def sheet(self) -> RobotSheet:
        return self.group.sheet

    @property
    def goals(self) -> tuple[Zone, Zone]:
        """Where they bring pellets, and where they take them."""
        return GOALS[ROLES[self.group.role]]


def _sheets(values: ArenaFile) -> _Sheets:
    ranges = values.randomisation.model_dump()
    robot = RobotSheet(**values.robot.model_dump())
    return _Sheets(
        robot=robot,
        groups=tuple(
            Group(one.name, replace(robot, **one.robot.model_dump(exclude_unset=True)), one.role, one.count)
            for one in values.groups
        ),
        pellets=PelletSheet(**values.pellets.model_dump()),
        timing=Timing(**values.timing.model_dump()),
        start=Start(
            Zone[values.start.zone.upper()], tuple((x, y, turn) for x, y, turn in values.start.poses)
        ),
        randomisation=Randomisation(**{name: (low, high) for name, (low, high) in ranges.items()}),
    )


def _sheet_mistakes(sheets: _Sheets) -> list[str]:
    kinds = sheets.kinds
    of_robots = [sentence for kind in kinds for sentence in checks.robot_mistakes(kind.sheet, kind.place)]
    of_substeps = [
        sentence
        for kind in kinds
        for sentence in checks.substep_mistakes(
            kind.sheet, sheets.pellets, sheets.timing, sheets.randomisation
        )
    ]
    return [
        *checks.group_mistakes(sheets.groups),
        *of_robots,
        *checks.timing_mistakes(sheets.timing, sheets.pellets),
        *checks.randomisation_mistakes(sheets.randomisation),
        *of_substeps,
    ]


def _places(zones: Zones, cell_size: float, sheets: _Sheets) -> tuple[Places, Places, list[str]]:
    """Start places and pellet places, and what does not fit."""
    start, radius, kinds = sheets.start, sheets.pellets.radius, sheets.kinds
    mistakes = list(checks.handover_mistakes(sheets.groups, zones))
    if not mistakes:
        mistakes = [
            sentence
            for kind in kinds
            for sentence in checks.passage_mistakes(kind.sheet, kind.place, kind.goals, zones, cell_size)
        ]
    if mistakes:
        return np.zeros((0, 2)), np.zeros((0, 2)), mistakes
    wall, source = zones == Zone.WALL, zones == Zone.SOURCE
    outer = max(kind.sheet.outer_radius for kind in kinds)
    passable = [_passable(kind, zones, cell_size) for kind in kinds]
    if start.poses:
        starts = np.array(start.poses)[:, :2]
        team = sheets.team(len(start.poses))
        own = [passable[group] for group in team.group]
        mistakes += checks.pose_mistakes(start, team.sheets, wall, own, cell_size)
    else:
        starts = disc_places(
            (zones == start.zone) & np.logical_and.reduce(passable),
            wall,
            cell_size,
            _CLEAR * outer,
            _APART * outer,
            _MOST_STARTS,
        )
    # Where a robot's nose can come, too: pellets along walls would never be taken, and pile up.
    diggers = [index for index, kind in enumerate(kinds) if kind.goals[1] == Zone.SOURCE]
    sides = [min(kinds[index].sheet.length, kinds[index].sheet.width) for index in diggers]
    clear = _CLEAR * max(radius, 0.5 * max(sides))
    dug = source & np.logical_and.reduce([passable[index] for index in diggers])
    pellets = disc_places(dug, wall, cell_size, clear, _APART * radius, _MOST_PELLET_PLACES)
    mistakes += checks.room_mistakes(outer, sheets.pellets, start, len(starts), len(pellets))
    return starts, pellets, mistakes


def _passable(kind: _Kind, zones: Zones, cell_size: float) -> NDArray[np.bool_]:
    """Return the cells on wide enough paths: between the goals of a kind, and to where it takes pellets."""
    free, cells = zones != Zone.WALL, checks.cells_wide(kind.sheet, cell_size)
    brings, takes = (zones == zone for zone in kind.goals)
    own = passage(free, brings, takes, cells)
    return own if kind.goals[0] == Zone.HOME else own | passage(free, zones == Zone.HOME, takes, cells)


def _assembled(
    values: ArenaFile, sheets: _Sheets, zones: Zones, starts: Places, pellets: Places, text: str, file: str
) -> Arena:
    wall, handover = zones == Zone.WALL, zones == Zone.HANDOVER
    walls = np.asarray(rectangles(wall) * values.cell_size, dtype=np.float64)
    for array in (zones, walls, starts, pellets):
        array.setflags(write=False)
    return Arena(
        name=values.name,
        description=values.description,
        file=file,
        text=text,
        zones=zones,
        cell_size=values.cell_size,
        walls=walls,
        distances=distance_field(~wall, zones == Zone.HOME, zones == Zone.SOURCE, values.cell_size),
        tunnel_length=tunnel_length(zones == Zone.TUNNEL, ~wall),
        handover=distances_to((handover,), ~wall, values.cell_size) if handover.any() else None,
        capacity=len(starts),
        start_places=starts,
        pellet_places=pellets,
        robot=sheets.robot,
        groups=sheets.groups,
        pellets=sheets.pellets,
        timing=sheets.timing,
        start=sheets.start,
        randomisation=sheets.randomisation,
    )
