"""What the sensors of real robots say, and the state that discretisation makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.equality import EqualByValue
from robosim.errors import InputError
from robosim.world.state import ABSENT, LOOSE, WorldState, blank_state

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

NOTHING = -1
"""In place of a pellet, where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings(EqualByValue):
    """What is known of a team of robots at one moment."""

    time: Floats
    """[robots] when each robot's pose was measured, on the clock of whoever calls the controller, s."""
    pose: Floats
    """[robots, 3] x m, y m, heading rad, on the arena's map; NaN where a robot is not seen."""
    laden: Bools
    """[robots] the gripper holds a pellet."""
    at_pellet: Bools
    """[robots] the gripper touches a loose pellet."""
    touched: Bools
    """[3, robots] touched another robot or its pellet, a wall, a loose pellet since the last decision."""
    pellet: Floats
    """[robots, 2] m, on the map: the loose pellet nearest to the gripper; NaN where none is known."""

    @property
    def robots(self) -> int:
        return len(self.time)

    def require_robots(self, robots: int) -> None:
        """Raise InputError unless every array is of so many robots."""
        shapes = {
            "time": (robots,),
            "pose": (robots, 3),
            "laden": (robots,),
            "at_pellet": (robots,),
            "touched": (3, robots),
            "pellet": (robots, 2),
        }
        for name, shape in shapes.items():
            given = np.shape(getattr(self, name))
            if given != shape:
                raise InputError(f"readings: {name} has the shape {list(given)}, but must be {list(shape)}.")


def of_one_robot(
    robot: int,
    time: Floats,
    pose: Floats,
    *,
    laden: bool,
    at_pellet: bool,
    touched: tuple[bool, bool, bool],
    pellet: tuple[float, float] | None,
) -> Readings:
    """Return the readings of a robot that knows its own sensors and everybody's pose.

    `time` [robots] and `pose` [robots, 3] come from the tracker. The others count as unladen and untouched,
    so the marks that they leave in this robot's pheromone map lack what they carry.
    """
    robots = len(time)
    here = np.arange(robots) == robot
    return Readings(
        time=time,
        pose=pose,
        laden=here & laden,
        at_pellet=here & at_pellet,
        touched=here & np.array(touched)[:, None],
        pellet=np.where(here[:, None], (np.nan, np.nan) if pellet is None else pellet, np.nan),
    )


def blank_team(robots: int) -> WorldState:
    """Return the state of one team in which each robot knows of at most one pellet, its own slot."""
    state = blank_state(1, robots, robots)
    state.nearest[0] = np.arange(robots)
    return state


def take_in(state: WorldState, readings: Readings) -> None:
    """Write all of the readings but time and pose into the state of one team."""
    own = state.nearest[0]
    state.held[0] = np.where(readings.laden, own, NOTHING)
    state.touching[0] = np.where(readings.at_pellet, own, NOTHING)
    state.touched[:, 0] = readings.touched
    known = np.asarray(np.isfinite(readings.pellet).all(axis=1))
    state.pellets[0] = np.where(known[:, None], readings.pellet, 0.0)
    state.pellet_status[0] = np.where(known, LOOSE, ABSENT)
