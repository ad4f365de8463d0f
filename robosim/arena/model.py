"""What an arena is, once read and checked: plain frozen data and numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from robosim.arena.distance import DistanceField
from robosim.robot.sheet import RobotSheet
from robosim.robot.team import Group, Role, Team


class Zone(IntEnum):
    """What a cell of the map is."""

    WALL = 0
    FLOOR = 1
    HOME = 2
    SOURCE = 3
    TUNNEL = 4
    HANDOVER = 5


ZONE_OF_CHARACTER = {
    "#": Zone.WALL,
    ".": Zone.FLOOR,
    "H": Zone.HOME,
    "S": Zone.SOURCE,
    "T": Zone.TUNNEL,
    "X": Zone.HANDOVER,
}

GOALS = {
    Role.ALL_ROUND: (Zone.HOME, Zone.SOURCE),
    Role.EXCAVATOR: (Zone.HANDOVER, Zone.SOURCE),
    Role.TRANSPORTER: (Zone.HOME, Zone.HANDOVER),
}
"""Where robots of a role bring pellets, and where they take them."""


@dataclass(frozen=True, slots=True)
class PelletSheet:
    """The pellets: discs that lie in the source until a robot takes them."""

    count: int = 60
    """Pellets in the arena; a delivered one is replaced by a fresh one in the source."""
    radius: float = 0.02
    """m."""
    mass: float = 0.02
    """kg."""
    friction: float = 0.2
    """Coefficient of friction against the ground, and against other bodies."""
    cohesion: float = 0.0
    """Largest force with which two touching pellets hold together, N."""


@dataclass(frozen=True, slots=True)
class Timing:
    """How time is cut: a decision is some control periods, a control period some substeps."""

    decision_period: float = 0.3
    """Time between two decisions of a policy, s."""
    control_period: float = 0.1
    """Time for which wheel speeds are held, s; divides the decision period."""
    substeps: int = 12
    """Physics steps in a control period."""
    episode_steps: int = 5000
    """Decisions in an episode."""

    @property
    def control_steps(self) -> int:
        """Control periods in a decision."""
        return round(self.decision_period / self.control_period)

    @property
    def substep(self) -> float:
        """Length of a physics step, s."""
        return self.control_period / self.substeps


@dataclass(frozen=True, slots=True)
class Start:
    """Where robots begin: at given poses, or at random free places of one zone."""

    zone: Zone = Zone.HOME
    poses: tuple[tuple[float, float, float], ...] = ()
    """(x m, y m, heading rad) of each robot, used in order; empty for random places in `zone`."""


@dataclass(frozen=True, slots=True)
class Randomisation:
    """Ranges of factors drawn anew in every episode, one draw per robot (or per pellet)."""

    robot_mass: tuple[float, float] = (1.0, 1.0)
    traction: tuple[float, float] = (1.0, 1.0)
    wheel_speed: tuple[float, float] = (1.0, 1.0)
    pellet_mass: tuple[float, float] = (1.0, 1.0)
    pellet_friction: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Arena:
    """A checked arena. Row 0 of every grid is the bottom row: y grows upward, x to the right.

    The centre of cell (row, column) lies at ((column + 0.5) * cell_size, (row + 0.5) * cell_size).
    """

    name: str
    description: str
    file: str
    """Where it was read from."""
    text: str
    """The file's text, so that recordings and policies can carry their arena."""
    zones: NDArray[np.uint8]
    """[rows, columns] codes of `Zone`."""
    cell_size: float
    """m."""
    walls: NDArray[np.float64]
    """[n, 4] rectangles (x0, y0, x1, y1) in m that cover the wall cells exactly, without overlap."""
    distances: DistanceField
    """Geodesic distances to home and to the source at any point."""
    tunnel_length: int
    """Length of the longest tunnel along its axis, in cells (L of the density n / L); 0 without one."""
    capacity: int
    """The most robots that fit at the start."""
    start_places: NDArray[np.float64]
    """[capacity, 2] places in m where robots can start without touching; the poses when given."""
    pellet_places: NDArray[np.float64]
    """[n, 2] places in the source, in m, where pellets can lie without touching; n >= pellets.count."""
    robot: RobotSheet = field(default_factory=RobotSheet)
    """The data sheet of all robots, or, where there are groups, what their own differ from."""
    groups: tuple[Group, ...] = ()
    """Of the team that this arena asks for; empty for a team of equals."""
    handover: DistanceField | None = None
    """Geodesic distances to the hand-over; None in an arena without one."""
    pellets: PelletSheet = field(default_factory=PelletSheet)
    timing: Timing = field(default_factory=Timing)
    start: Start = field(default_factory=Start)
    randomisation: Randomisation = field(default_factory=Randomisation)
    as_text: bool = True
    """Whether all of it is what `text` says; not where a world has put timing and starts of its own."""

    def team(self, robots: int) -> Team:
        """Return a team of so many robots."""
        return Team.dealt(self.groups or (Group("robots", self.robot),), robots)

    @property
    def rows(self) -> int:
        """Cells from bottom to top."""
        return int(self.zones.shape[0])

    @property
    def columns(self) -> int:
        """Cells from left to right."""
        return int(self.zones.shape[1])

    @property
    def size(self) -> tuple[float, float]:
        """(width, height), m."""
        return self.columns * self.cell_size, self.rows * self.cell_size

    def _repr_html_(self) -> str:
        from robosim.arena.picture import arena_html

        return arena_html(self)
