"""What an arena file may say: every key with its type and range, and mistakes as sentences."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import ErrorDetails

from robosim.arena.model import PelletSheet, Timing
from robosim.errors import nearest_names, shown
from robosim.robot.sheet import BodyShape, RobotSheet
from robosim.robot.team import RoleName

_ROBOT, _PELLETS, _TIMING = RobotSheet(), PelletSheet(), Timing()

MOST_GROUPS = 8
"""In a team."""

Table = dict[str, Any]
_Factor = Annotated[float, Field(ge=0.1, le=10.0)]
FactorRange = Annotated[list[_Factor], Field(min_length=2, max_length=2)]
_Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Pose = Annotated[list[_Coordinate], Field(min_length=3, max_length=3)]


def _number(default: float, low: float, high: float, unit: str = "") -> Any:
    return Field(default, ge=low, le=high, description=f"a number from {low:g} to {high:g} {unit}".rstrip())


def _count(default: int, low: int, high: int) -> Any:
    return Field(default, ge=low, le=high, description=f"a whole number from {low} to {high}")


def _factors() -> Any:
    return Field([1.0, 1.0], description="two factors [low, high], each a number from 0.1 to 10")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class RobotSection(_Strict):
    """The table [robot]."""

    shape: BodyShape = Field(default=_ROBOT.shape, description='"circle", "capsule" or "box"')
    length: float = _number(_ROBOT.length, 0.01, 2, "m")
    width: float = _number(_ROBOT.width, 0.01, 2, "m")
    mass: float = _number(_ROBOT.mass, 0.01, 100, "kg")
    wheel_radius: float = _number(_ROBOT.wheel_radius, 0.001, 0.5, "m")
    wheel_base: float = _number(_ROBOT.wheel_base, 0.005, 2, "m")
    max_wheel_speed: float = _number(_ROBOT.max_wheel_speed, 0.1, 1000, "rad/s")
    max_wheel_acceleration: float = _number(_ROBOT.max_wheel_acceleration, 0.1, 100_000, "rad/s^2")
    traction: float = _number(_ROBOT.traction, 0.01, 5)
    friction: float = _number(_ROBOT.friction, 0, 5)
    gripper_reach: float = _number(_ROBOT.gripper_reach, 0.001, 0.5, "m")
    grip_force: float = _number(_ROBOT.grip_force, 0.001, 1000, "N")


class GroupSection(_Strict):
    """A table of [[groups]]: robots that are alike."""

    name: str = Field(
        min_length=1,
        max_length=60,
        pattern=r"^\w[\w -]*$",
        description="1 to 60 letters, digits, spaces, dashes or underscores",
    )
    role: RoleName = Field(default="all-round", description='"all-round", "excavator" or "transporter"')
    count: int = _count(1, 1, 100)
    robot: RobotSection = Field(RobotSection(), description="a table")
    """Keys in which these robots differ from the table [robot]."""


class PelletSection(_Strict):
    """The table [pellets]."""

    count: int = _count(_PELLETS.count, 1, 2000)
    radius: float = _number(_PELLETS.radius, 0.002, 0.5, "m")
    mass: float = _number(_PELLETS.mass, 0.0001, 10, "kg")
    friction: float = _number(_PELLETS.friction, 0, 5)
    cohesion: float = _number(_PELLETS.cohesion, 0, 100, "N")


class TimingSection(_Strict):
    """The table [timing]."""

    decision_period: float = _number(_TIMING.decision_period, 0.01, 10, "s")
    control_period: float = _number(_TIMING.control_period, 0.001, 1, "s")
    substeps: int = _count(_TIMING.substeps, 1, 200)
    episode_steps: int = _count(_TIMING.episode_steps, 1, 1_000_000)


class StartSection(_Strict):
    """The table [start]."""

    zone: Literal["home", "floor", "tunnel"] = Field(
        default="home", description='"home", "floor" or "tunnel"'
    )
    poses: list[Pose] = Field(
        default=[],
        max_length=500,
        description="at most 500 poses [x m, y m, heading rad], three numbers each",
    )


class RandomisationSection(_Strict):
    """The table [randomisation]."""

    robot_mass: FactorRange = _factors()
    traction: FactorRange = _factors()
    wheel_speed: FactorRange = _factors()
    pellet_mass: FactorRange = _factors()
    pellet_friction: FactorRange = _factors()


class ArenaFile(_Strict):
    """A whole arena file."""

    name: str = Field(
        min_length=1,
        max_length=60,
        pattern=r"^\w[\w .-]*$",
        description="1 to 60 letters, digits, spaces, dots, dashes or underscores",
    )
    description: str = Field(
        "", max_length=2000, pattern=r"^(?:[^\p{Cc}]|\n)*$", description="at most 2000 printable characters"
    )
    cell_size: float = Field(ge=0.01, le=2.0, description="a number from 0.01 to 2 m")
    map: str = Field(description="the map as text, one character a cell")
    robot: RobotSection = Field(RobotSection(), description="a table")
    groups: list[GroupSection] = Field(
        default=[], min_length=2, max_length=MOST_GROUPS, description=f"2 to {MOST_GROUPS} tables [[groups]]"
    )
    pellets: PelletSection = Field(PelletSection(), description="a table")
    timing: TimingSection = Field(TimingSection(), description="a table")
    start: StartSection = Field(StartSection(), description="a table")
    randomisation: RandomisationSection = Field(RandomisationSection(), description="a table")


def mistake(error: ErrorDetails, data: Table) -> str:
    """Turn one of pydantic's errors into our sentence, without the file's name.

    Parts of a list are reported as their list, so one sentence may come up more than once.
    """
    path = _path_to_key(error["loc"])
    keys = [part for part in path if isinstance(part, str)]
    model: type[BaseModel] = ArenaFile
    for key in keys[:-1]:
        model = _section(model, key)
    place = "".join(f"[{part}]" if isinstance(part, int) else f".{_named(part)}" for part in path)[1:]
    if error["type"] == "extra_forbidden":
        return f"{place} is not a key of an arena file: {nearest_names(keys[-1], model.model_fields)}"
    allowed = "a table" if isinstance(path[-1], int) else model.model_fields[keys[-1]].description
    if error["type"] == "missing":
        return f"{place} is missing; it must be {allowed}."
    value: Any = data
    for part in path:
        value = value[part]
    return f"{place} is {shown(value)}, but must be {allowed}."


def _path_to_key(loc: tuple[int | str, ...]) -> list[int | str]:
    """Return where a mistake is: the whole list for a part of one, unless it is a list of tables."""
    path: list[int | str] = []
    for part in loc:
        if isinstance(part, int) and path != ["groups"]:
            break
        path.append(part)
    return path


def _named(key: str) -> str:
    return key if key.isidentifier() else json.dumps(key)


def _section(model: type[BaseModel], key: str) -> type[BaseModel]:
    section = model.model_fields[key].annotation
    (section,) = get_args(section) or (section,)
    assert isinstance(section, type)  # noqa: S101  the file's tables are models, one each
    assert issubclass(section, BaseModel)  # noqa: S101
    return section
