"""The modes of a robot: what it is about to do, read off where it is and what it holds."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Zone
from robosim.world.state import Gripper


class Mode(IntEnum):
    """The internal state of a robot (the paper's section on state and observation)."""

    GOING_TO_DIG = 0
    DIGGING = 1
    EXIT_DIGGING = 2
    GOING_HOME = 3
    DUMPING = 4
    EXIT_HOME = 5
    COLLISION = 6
    """Overlays the others while the robot is blocked."""


_LADEN = np.full(len(Zone), Mode.GOING_HOME, dtype=np.uint8)
_LADEN[Zone.SOURCE] = Mode.EXIT_DIGGING
_LADEN[Zone.HOME] = Mode.DUMPING
_UNLADEN = np.full(len(Zone), Mode.GOING_TO_DIG, dtype=np.uint8)
_UNLADEN[Zone.SOURCE] = Mode.DIGGING
_UNLADEN[Zone.HOME] = Mode.EXIT_HOME
# A loose pellet at the gripper, outside the home, is dug where it lies.
_UNLADEN_TOUCHING = _UNLADEN.copy()
_UNLADEN_TOUCHING[Zone.FLOOR] = Mode.DIGGING
_UNLADEN_TOUCHING[Zone.TUNNEL] = Mode.DIGGING
_MODES = np.stack([_UNLADEN, _UNLADEN_TOUCHING, _LADEN, _LADEN]).ravel()
_LADEN_ROW, _TOUCHING_ROW = 2 * len(Zone), len(Zone)

_GRIPPERS = np.full(len(Mode), Gripper.KEEP, dtype=np.int8)
_GRIPPERS[Mode.DIGGING] = Gripper.TAKE
_GRIPPERS[Mode.DUMPING] = Gripper.OPEN


def modes(
    zone: NDArray[np.uint8], laden: NDArray[np.bool_], touching: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Return the modes, without collisions, of robots that are in `zone`.

    `laden` says that a robot holds a pellet, `touching` that its gripper touches a loose one; all
    arrays have the same shape.
    """
    return _MODES.take(_LADEN_ROW * laden + _TOUCHING_ROW * touching + zone)


def gripper_commands(mode: NDArray[np.uint8]) -> NDArray[np.int8]:
    """Return what the grippers do in the given modes: take in Digging, open in Dumping."""
    return _GRIPPERS.take(mode)
