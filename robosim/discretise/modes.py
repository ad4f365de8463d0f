"""The modes of a robot: what it is about to do, read off where it is and what it holds."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import GOALS, Zone
from robosim.robot.team import Role
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


Integers = NDArray[np.int64]


def _modes_of(role: Role) -> NDArray[np.uint8]:
    """Return the modes [unladen, unladen with a loose pellet at the gripper, laden, laden] by zone."""
    brings, takes = GOALS[role]
    laden = np.full(len(Zone), Mode.GOING_HOME, dtype=np.uint8)
    laden[takes] = Mode.EXIT_DIGGING
    laden[brings] = Mode.DUMPING
    unladen = np.full(len(Zone), Mode.GOING_TO_DIG, dtype=np.uint8)
    unladen[takes] = Mode.DIGGING
    unladen[brings] = Mode.EXIT_HOME
    # A loose pellet at the gripper is dug where it lies, unless that zone is the affair of others.
    touching = unladen.copy()
    touching[[Zone.FLOOR, Zone.TUNNEL]] = Mode.DIGGING
    if role == Role.ALL_ROUND:
        touching[Zone.HANDOVER] = Mode.DIGGING
    return np.stack([unladen, touching, laden, laden])


_MODES = np.stack([_modes_of(role) for role in Role]).ravel()
_TOUCHING_ROW, _LADEN_ROW, _ROLE_ROW = len(Zone), 2 * len(Zone), 4 * len(Zone)

_GRIPPERS = np.full(len(Mode), Gripper.KEEP, dtype=np.int8)
_GRIPPERS[Mode.DIGGING] = Gripper.TAKE
_GRIPPERS[Mode.DUMPING] = Gripper.OPEN


def modes(
    zone: NDArray[np.uint8],
    laden: NDArray[np.bool_],
    touching: NDArray[np.bool_],
    role: Integers | None = None,
) -> NDArray[np.uint8]:
    """Return the modes, without collisions, of robots that are in `zone`.

    `laden` says that a robot holds a pellet, `touching` that its gripper touches a loose one; all
    arrays have the same shape, [..., robots]. `role` [robots] is their `Role`, None where
    all do all the work.
    """
    row = _LADEN_ROW * laden + _TOUCHING_ROW * touching + zone
    return _MODES.take(row if role is None else row + _ROLE_ROW * role)


def gripper_commands(mode: NDArray[np.uint8]) -> NDArray[np.int8]:
    """Return what the grippers do in the given modes: take in Digging, open in Dumping."""
    return _GRIPPERS.take(mode)
