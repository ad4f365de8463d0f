"""What an arena file may say: every key with its type and range, and mistakes as sentences."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from robosim.arena.model import PelletSheet, Randomisation, Start, Timing
from robosim.errors import nearest_names
from robosim.robot.sheet import BodyShape, RobotSheet

_ROBOT, _PELLETS, _TIMING = RobotSheet(), PelletSheet(), Timing()

Factor = Annotated[float, Field(ge=0.1, le=10.0)]
FactorRange = Annotated[list[Factor], Field(min_length=2, max_length=2)]
Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Pose = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class RobotSection(_Strict):
    """[robot]"""

    shape: BodyShape = _ROBOT.shape
    length: float = Field(_ROBOT.length, ge=0.01, le=2.0)
    width: float = Field(_ROBOT.width, ge=0.01, le=2.0)
    mass: float = Field(_ROBOT.mass, ge=0.01, le=100.0)
    wheel_radius: float = Field(_ROBOT.wheel_radius, ge=0.001, le=0.5)
    wheel_base: float = Field(_ROBOT.wheel_base, ge=0.005, le=2.0)
    max_wheel_speed: float = Field(_ROBOT.max_wheel_speed, ge=0.1, le=1000.0)
    max_wheel_acceleration: float = Field(_ROBOT.max_wheel_acceleration, ge=0.1, le=100_000.0)
    traction: float = Field(_ROBOT.traction, ge=0.01, le=5.0)
    friction: float = Field(_ROBOT.friction, ge=0.0, le=5.0)
    gripper_reach: float = Field(_ROBOT.gripper_reach, ge=0.001, le=0.5)
    grip_force: float = Field(_ROBOT.grip_force, ge=0.001, le=1000.0)


class PelletSection(_Strict):
    """[pellets]"""

    count: int = Field(_PELLETS.count, ge=1, le=2000)
    radius: float = Field(_PELLETS.radius, ge=0.002, le=0.5)
    mass: float = Field(_PELLETS.mass, ge=0.0001, le=10.0)
    friction: float = Field(_PELLETS.friction, ge=0.0, le=5.0)
    cohesion: float = Field(_PELLETS.cohesion, ge=0.0, le=100.0)


class TimingSection(_Strict):
    """[timing]"""

    decision_period: float = Field(_TIMING.decision_period, ge=0.01, le=10.0)
    control_period: float = Field(_TIMING.control_period, ge=0.001, le=1.0)
    substeps: int = Field(_TIMING.substeps, ge=1, le=200)
    episode_steps: int = Field(_TIMING.episode_steps, ge=1, le=1_000_000)


class StartSection(_Strict):
    """[start]"""

    zone: Literal["home", "floor", "source", "tunnel"] = "home"
    poses: list[Pose] = Field([], max_length=500)


class RandomisationSection(_Strict):
    """[randomisation]"""

    robot_mass: FactorRange = [1.0, 1.0]
    traction: FactorRange = [1.0, 1.0]
    wheel_speed: FactorRange = [1.0, 1.0]
    pellet_mass: FactorRange = [1.0, 1.0]
    pellet_friction: FactorRange = [1.0, 1.0]


class ArenaFile(_Strict):
    """A whole arena file."""

    name: str = Field(min_length=1, max_length=60)
    description: str = Field("", max_length=2000)
    cell_size: float = Field(ge=0.01, le=2.0)
    map: str = Field(min_length=1, max_length=200_000)
    robot: RobotSection = RobotSection()
    pellets: PelletSection = PelletSection()
    timing: TimingSection = TimingSection()
    start: StartSection = StartSection()
    randomisation: RandomisationSection = RandomisationSection()
