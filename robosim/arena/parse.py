"""From the text of an arena file to a checked Arena."""

from __future__ import annotations

import tomllib

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from robosim.arena.distance import distance_field
from robosim.arena.geometry import disc_places, rectangles
from robosim.arena.model import (
    ZONE_OF_CHARACTER,
    Arena,
    PelletSheet,
    Randomisation,
    Start,
    Timing,
    Zone,
)
from robosim.arena.schema import ArenaFile
from robosim.errors import InputError
from robosim.robot.sheet import RobotSheet


def parse_arena(text: str, file: str) -> Arena:
    """Check an arena file's text; `file` is the name that messages use."""
    try:
        data = ArenaFile.model_validate(tomllib.loads(text))
    except (ValueError, ValidationError) as error:
        raise InputError(f"{file}: {error}") from None
    lines = data.map.strip("\n").split("\n")
    zones = np.array([[ZONE_OF_CHARACTER[c] for c in line] for line in reversed(lines)], dtype=np.uint8)
    robot = RobotSheet(**data.robot.model_dump())
    pellets = PelletSheet(**data.pellets.model_dump())
    c = data.cell_size
    wall = zones == Zone.WALL
    start = Start(Zone[data.start.zone.upper()], tuple((p[0], p[1], p[2]) for p in data.start.poses))
    r = robot.outer_radius
    if start.poses:
        start_places = np.array(start.poses)[:, :2]
    else:
        start_places = disc_places(zones == start.zone, wall, c, 1.02 * r, 2.05 * r, 1000)
    pellet_places = disc_places(
        zones == Zone.SOURCE, wall, c, 1.02 * pellets.radius, 2.05 * pellets.radius, 10_000
    )
    walls = rectangles(wall) * c
    zones.setflags(write=False)
    return Arena(
        name=data.name,
        description=data.description,
        file=file,
        text=text,
        zones=zones,
        cell_size=c,
        walls=walls,
        distances=distance_field(~wall, zones == Zone.HOME, zones == Zone.SOURCE, c),
        capacity=len(start_places),
        start_places=start_places,
        pellet_places=pellet_places,
        robot=robot,
        pellets=pellets,
        timing=Timing(**data.timing.model_dump()),
        start=start,
        randomisation=Randomisation(**{k: (v[0], v[1]) for k, v in data.randomisation.model_dump().items()}),
    )
