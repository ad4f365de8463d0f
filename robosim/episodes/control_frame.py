"""What a recorder reads of a controller of real robots in one control period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.equality import EqualByValue

LOG_SUFFIX = ".jsonl"
"""What the name of a controller's log ends in."""


@dataclass(frozen=True, slots=True, eq=False)
class ControlFrame(EqualByValue):
    """A team as its controller knew it, and what it commanded. Copy what you keep of the arrays."""

    step: int
    """Decisions before this one, from 0."""
    time: float
    """s since the first control period."""
    decides: bool
    """Whether a decision begins."""
    begins: bool
    """Whether a run begins: with the first control period, and where the controller was reset."""
    pose: NDArray[np.float64]
    """[robots, 3] x m, y m, heading rad, where robots were last seen on the map."""
    age: NDArray[np.float64]
    """[robots] s since the pose was measured; NaN where nobody knows."""
    mode: NDArray[np.uint8]
    """[robots] `Mode`; COLLISION overlays the others."""
    laden: NDArray[np.bool_]
    """[robots] holds a pellet."""
    touched: NDArray[np.bool_]
    """[3, robots] touched another robot or its pellet, a wall, a loose pellet since the last decision."""
    pellet: NDArray[np.float64]
    """[robots, 2] m, the loose pellet that a robot knows of; NaN where there is none on the map."""
    pheromone: NDArray[np.float64] | None
    """[rows, columns] occupancy, row 0 at the bottom; None where the map was not the controller's own."""
    action: NDArray[np.int64]
    """[robots] decided last."""
    target: NDArray[np.float64]
    """[robots, 2] m, the middle of the cell that was chosen; NaN for robots that were told to stop, and where
    actions are wheel speeds."""
    wheel_speeds: NDArray[np.float64]
    """[robots, 2] commanded, rad/s."""
    gripper: NDArray[np.int8]
    """[robots] `Gripper`, to be done at the end of the decision."""
    stopped: tuple[str, ...]
    """[robots] why a robot is stopped; empty for those that are not."""
    unstopped: NDArray[np.bool_]
    """[robots] an emergency stop could not be seen to hold this robot."""
    emergency: str
    """Why all are held; empty when they are not."""
