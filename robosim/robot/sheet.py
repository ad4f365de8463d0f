"""The robot's data sheet: what it weighs, how it is shaped, what its wheels can do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

GRAVITY = 9.81
"""Acceleration of free fall, m/s^2."""

BodyShape = Literal["circle", "capsule", "box"]


@dataclass(frozen=True, slots=True)
class RobotSheet:
    """Data sheet of a differential-drive robot, in SI units.

    The defaults are the Robotarium's robot (robotarium_python_simulator); what that source
    leaves open (mass, acceleration, friction, gripper) is ours.
    """

    shape: BodyShape = "circle"
    """Outline seen from above; a capsule or a box points along +x of the body."""
    length: float = 0.11
    """Extent along the heading, m; the diameter of a circle."""
    width: float = 0.11
    """Extent across the heading, m; equals `length` for a circle."""
    mass: float = 0.4
    """kg."""
    wheel_radius: float = 0.016
    """m."""
    wheel_base: float = 0.11
    """Distance between the wheels, m."""
    max_wheel_speed: float = 12.5
    """rad/s; with the wheel radius it gives the top speed, 0.2 m/s."""
    max_wheel_acceleration: float = 125.0
    """rad/s^2; with the wheel radius 2 m/s^2."""
    traction: float = 0.6
    """Coefficient of friction between wheels and ground."""
    friction: float = 0.3
    """Coefficient of friction of the body's side against walls, robots and pellets."""
    gripper_reach: float = 0.04
    """How far beyond contact the gripper at the nose takes a pellet, m."""
    grip_force: float = 2.0
    """Largest force that the gripper holds against, N; a harder pull tears the pellet loose."""

    @property
    def top_speed(self) -> float:
        """Speed with both wheels at their limit, m/s."""
        return self.wheel_radius * self.max_wheel_speed

    @property
    def top_turn_rate(self) -> float:
        """Turning rate with the wheels at opposite limits, rad/s."""
        return 2.0 * self.top_speed / self.wheel_base

    @property
    def top_acceleration(self) -> float:
        """Largest acceleration, forward or braking, that wheels and traction allow, m/s^2."""
        return min(self.wheel_radius * self.max_wheel_acceleration, self.traction * GRAVITY)

    @property
    def traction_force(self) -> float:
        """Largest force that the wheels pass to the ground, N (Coulomb)."""
        return self.traction * self.mass * GRAVITY

    @property
    def outer_radius(self) -> float:
        """Radius of the smallest circle about the centre that holds the outline, m."""
        if self.shape == "box":
            return 0.5 * float((self.length**2 + self.width**2) ** 0.5)
        return 0.5 * max(self.length, self.width)
