"""What stands for what in a recording: colours and names of modes, zones, pellets, contacts and clogs."""

from __future__ import annotations

from dataclasses import dataclass

from robosim.analysis.clogs.clog import Cause
from robosim.arena.model import Zone
from robosim.discretise.modes import Mode
from robosim.robot.team import Team
from robosim.world.contacts import ContactKind

Colour = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Style:
    """A name and a colour."""

    label: str
    colour: Colour


# Blue goes out for a pellet, green comes home with one, and red is what should not be.
MODES: dict[Mode, Style] = {
    Mode.GOING_TO_DIG: Style("Going to dig", (29, 105, 214)),
    Mode.DIGGING: Style("Digging", (140, 66, 201)),
    Mode.EXIT_DIGGING: Style("Exit digging", (132, 204, 90)),
    Mode.GOING_HOME: Style("Going home", (22, 137, 62)),
    Mode.DUMPING: Style("Dumping", (235, 190, 20)),
    Mode.EXIT_HOME: Style("Exit home", (104, 184, 246)),
    Mode.COLLISION: Style("Collision", (222, 32, 38)),
}

LOOSE_PELLET = Style("Loose pellet", (121, 85, 58))
HELD_PELLET = Style("Held pellet", (255, 128, 0))

CONTACTS: dict[ContactKind, Style] = {
    ContactKind.ROBOT_ROBOT: Style("Hits robot", (255, 0, 102)),
    ContactKind.ROBOT_WALL: Style("Hits wall", (0, 170, 190)),
    ContactKind.ROBOT_PELLET: Style("Hits pellet", (255, 200, 120)),
}

CLOG = Style("In a clog", (230, 0, 230))
"""The ring round a robot in a clog."""
LINK: Colour = (36, 0, 48)
"""The line between two that are linked in a clog: dark, since bodies of all colours lie under it."""

# Distinct also for those who see two of red, green and blue as one; the modes beside them have names.
CAUSES: dict[Cause, Colour] = {
    Cause.HEAD_ON: (245, 120, 30),
    Cause.PELLET: (110, 74, 44),
    Cause.TURNING: (0, 130, 140),
    Cause.QUEUE: (205, 208, 216),
}
"""Of a clog's interval."""

ZONES: dict[Zone, Style] = {
    Zone.WALL: Style("Wall", (74, 80, 92)),
    Zone.FLOOR: Style("Floor", (240, 240, 236)),
    Zone.HOME: Style("HOME", (212, 236, 214)),
    Zone.SOURCE: Style("SOURCE", (246, 224, 196)),
    Zone.TUNNEL: Style("TUNNEL", (218, 226, 238)),
    Zone.HANDOVER: Style("HAND-OVER", (238, 218, 236)),
}

ZONE_NAME: Colour = (222, 226, 234)
OUTLINE: Colour = (24, 26, 32)
HEADING: Colour = (255, 255, 255)
TEAM: Colour = (240, 240, 240)
PHEROMONE: Colour = (84, 40, 150)
BACKGROUND: Colour = (16, 18, 22)

STOPPED = Style("Stopped", CLOG.colour)
"""The ring round a robot that its controller has stopped."""
KNOWN_PELLET = Style("Pellet known of", LOOSE_PELLET.colour)
CARRIES = Style("Carries a pellet", HELD_PELLET.colour)
CHOSEN = Style("Chosen cell", TEAM)
WHEELS = Style("Wheel speeds", (0, 130, 140))

ROBOTS: tuple[Colour, ...] = (
    (86, 160, 235),
    (255, 150, 60),
    (96, 200, 110),
    (240, 90, 90),
    (178, 130, 225),
    (190, 140, 120),
    (238, 130, 200),
    (150, 150, 150),
    (205, 205, 70),
    (70, 205, 215),
)
"""One colour a robot in the plots and tracks, over again beyond ten; in a mixed team one a group."""
SHADE, SHADES = 0.16, 4
"""How much lighter each next robot of a group is, and after how many it begins again."""


def robot_colours(team: Team) -> list[Colour]:
    """Return the colour of each robot's line and track: in a mixed team a shade of its group's."""
    if not team.mixed:
        return [ROBOTS[robot % len(ROBOTS)] for robot in range(team.robots)]
    before = [int((team.group[:robot] == group).sum()) for robot, group in enumerate(team.group)]
    return [
        _lighter(ROBOTS[group], SHADE * (count % SHADES))
        for group, count in zip(team.group.tolist(), before, strict=True)
    ]


def group_styles(team: Team) -> list[Style]:
    """Return name and colour of each group of a mixed team; none for a team of equals."""
    styles = [Style(group.name, ROBOTS[number]) for number, group in enumerate(team.groups)]
    return styles if team.mixed else []


def heading_colours(team: Team) -> list[Colour]:
    """Return the colour of each robot's line ahead: white, or in a mixed team its group's."""
    return [ROBOTS[group] if team.mixed else HEADING for group in team.group.tolist()]


def control_legend(team: Team) -> list[Style]:
    """Return what the legend names where a controller's log is shown."""
    return [*MODES.values(), KNOWN_PELLET, CARRIES, CHOSEN, WHEELS, STOPPED, *group_styles(team)]


def _lighter(colour: Colour, share: float) -> Colour:
    red, green, blue = (round(part + share * (255 - part)) for part in colour)
    return red, green, blue


def legend(team: Team) -> list[Style]:
    """Return what the legend names, in its order."""
    modes = [*MODES.values(), LOOSE_PELLET, HELD_PELLET, *CONTACTS.values(), CLOG]
    return [*modes, *group_styles(team)]
