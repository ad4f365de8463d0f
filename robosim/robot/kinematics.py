"""Differential-drive kinematics: wheel speeds and the motion of the body, in batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.robot.team import TeamSheet, per_wheel

Floats = NDArray[np.float64]


def body_twist(sheet: TeamSheet, wheel_speeds: Floats) -> tuple[Floats, Floats]:
    """Return forward speed (m/s) and turning rate (rad/s, left positive) for wheel speeds.

    `wheel_speeds` is [..., 2] (left, right) in rad/s; both results are [...]. With arrays [robots] in `sheet`
    the last of these axes is that of the robots.
    """
    left, right = wheel_speeds[..., 0], wheel_speeds[..., 1]
    speed = (0.5 * sheet.wheel_radius) * (left + right)
    turn_rate = (sheet.wheel_radius / sheet.wheel_base) * (right - left)
    return speed, turn_rate


def wheel_speeds_for(sheet: TeamSheet, speed: Floats, turn_rate: Floats) -> Floats:
    """Return the wheel speeds [..., 2] (left, right; rad/s) that give `speed` and `turn_rate`.

    The inverse of `body_twist`; the result may exceed the data sheet.
    """
    wheels = np.empty((*np.shape(speed), 2))
    half = (0.5 * sheet.wheel_base) * turn_rate
    np.subtract(speed, half, out=wheels[..., 0])
    np.add(speed, half, out=wheels[..., 1])
    wheels *= per_wheel(1.0 / sheet.wheel_radius)
    return wheels


def driven(pose: Floats, speed: Floats, turn_rate: Floats, time: Floats | float) -> Floats:
    """Return where a body [..., 3] (x m, y m, heading rad) is after it has moved so for a time (s).

    `speed` (m/s) and `turn_rate` (rad/s) are [...] and constant, so the body describes an arc. The heading is
    not folded.
    """
    half_turn = turn_rate * (0.5 * time)
    chord = speed * time * np.sinc(half_turn / np.pi)
    course = pose[..., 2] + half_turn
    return np.stack(
        [
            pose[..., 0] + chord * np.cos(course),
            pose[..., 1] + chord * np.sin(course),
            pose[..., 2] + 2.0 * half_turn,
        ],
        axis=-1,
    )


def moved_on(pose: Floats, before: Floats, now: Floats) -> Floats:
    """Return `pose` [..., 3] after the motion from `before` to `now` [..., 3], as seen by who moves.

    The heading is not folded.
    """
    apart = now - before
    turned = pose[..., 2] - before[..., 2]
    cos, sin = np.cos(turned), np.sin(turned)
    moved = pose + apart
    moved[..., 0] = pose[..., 0] + cos * apart[..., 0] - sin * apart[..., 1]
    moved[..., 1] = pose[..., 1] + sin * apart[..., 0] + cos * apart[..., 1]
    return moved


def slew(current: Floats, command: Floats, max_speed: Floats | float, max_change: Floats | float) -> Floats:
    """Return the wheel speeds one control period later, within the limits of speed and acceleration.

    `current` and `command` are wheel speeds in rad/s, `max_change` the largest change (rad/s) that
    the wheels' acceleration allows in the period.
    """
    low = np.maximum(current - max_change, -max_speed)
    high = current + max_change
    np.minimum(high, max_speed, out=high)
    np.maximum(low, command, out=low)
    return np.minimum(low, high, out=low)


def wrap_angle(angle: Floats) -> Floats:
    """Return `angle` (rad) folded into [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
