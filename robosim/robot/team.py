"""Teams: a data sheet and a role for each robot, in groups; a team of equals is the simplest of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robosim.robot.sheet import RobotSheet

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RoleName = Literal["all-round", "excavator", "transporter"]


class Role(IntEnum):
    """What part of the work a robot does."""

    ALL_ROUND = 0
    """Digs in the source and brings home."""
    EXCAVATOR = 1
    """Digs in the source and hands over."""
    TRANSPORTER = 2
    """Takes what was handed over and brings it home."""


ROLES: dict[RoleName, Role] = {
    "all-round": Role.ALL_ROUND,
    "excavator": Role.EXCAVATOR,
    "transporter": Role.TRANSPORTER,
}


@dataclass(frozen=True, slots=True)
class Group:
    """Robots that are alike."""

    name: str
    sheet: RobotSheet
    role: RoleName = "all-round"
    count: int = 1
    """How many robots it gets whenever robots are dealt out to the groups in turn."""


@dataclass(frozen=True, slots=True, eq=False)
class SheetArrays:
    """The numbers of several data sheets, [robots] each, under the names that they have in one."""

    length: Floats
    width: Floats
    wheel_radius: Floats
    wheel_base: Floats
    max_wheel_speed: Floats
    max_wheel_acceleration: Floats
    gripper_reach: Floats
    top_speed: Floats
    top_acceleration: Floats
    top_turn_rate: Floats
    traction_force: Floats
    outer_radius: Floats

    @classmethod
    def of(cls, sheets: Sequence[RobotSheet]) -> Self:
        """Return what the sheets say, robot by robot."""
        return cls(*[np.array([getattr(sheet, one.name) for sheet in sheets]) for one in fields(cls)])


TeamSheet = RobotSheet | SheetArrays
"""What holds for each robot of a team: numbers where all are alike, else arrays [robots]. Both broadcast."""


@dataclass(frozen=True, eq=False)
class Team:
    """The robots of a team by number."""

    groups: tuple[Group, ...]
    group: Integers
    """[robots] which of `groups` a robot belongs to."""

    @classmethod
    def dealt(cls, groups: tuple[Group, ...], robots: int) -> Team:
        """Return a team of `robots`: the groups get `count` robots each, in turn, over and over.

        So which group a robot belongs to does not depend on how many there are.
        """
        turn = np.repeat(np.arange(len(groups)), [one.count for one in groups])
        group = np.resize(turn, robots)
        group.setflags(write=False)
        return cls(groups, group)

    @property
    def robots(self) -> int:
        return len(self.group)

    @property
    def mixed(self) -> bool:
        """Whether there are several groups."""
        return len(self.groups) > 1

    @cached_property
    def sheets(self) -> tuple[RobotSheet, ...]:
        """[robots] the data sheet of each."""
        return tuple(self.groups[index].sheet for index in self.group.tolist())

    @cached_property
    def sheet(self) -> TeamSheet:
        """The data sheet of all robots where they have the same one, else arrays [robots]."""
        alike = len(set(self.sheets)) == 1
        return self.sheets[0] if alike else SheetArrays.of(self.sheets)

    @cached_property
    def reach(self) -> Floats:
        """How near two robots' centres can come without their outer circles touching, m.

        [1, 1] where all robots are alike, else [robots, robots].
        """
        radius = np.atleast_1d(np.asarray(self.sheet.outer_radius))
        return np.asarray(radius[:, None] + radius)

    @cached_property
    def role(self) -> Integers:
        """[robots] `Role` of each."""
        return np.array([ROLES[one.role] for one in self.groups], dtype=np.int64)[self.group]

    @cached_property
    def all_round(self) -> bool:
        """Whether every robot does all the work."""
        return not self.role.any()

    @property
    def names(self) -> tuple[str, ...]:
        """[robots] name of the group of each."""
        return tuple(self.groups[index].name for index in self.group.tolist())


def per_wheel(value: ArrayLike) -> Floats:
    """Return a number, or numbers [robots], in a shape that broadcasts against [..., robots, wheels]."""
    array = np.asarray(value, dtype=np.float64)
    return array[:, None] if array.ndim else array
