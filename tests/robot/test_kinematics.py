"""Wheel speeds and body motion are each other's inverse, within limits that nothing exceeds."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robosim.robot.kinematics import body_twist, driven, moved_on, slew, wheel_speeds_for, wrap_angle
from robosim.robot.sheet import GRAVITY, RobotSheet

SHEETS = st.builds(RobotSheet, wheel_radius=st.floats(0.001, 0.5), wheel_base=st.floats(0.005, 2.0))
SPEEDS = arrays(np.float64, (4, 3), elements=st.floats(-100.0, 100.0))


@given(SHEETS, SPEEDS, SPEEDS)
def test_speed_and_turning_rate_survive_the_way_through_the_wheels(sheet, speed, rate) -> None:
    wheels = wheel_speeds_for(sheet, speed, rate)
    assert wheels.shape == (4, 3, 2)
    again_speed, again_rate = body_twist(sheet, wheels)
    size = np.abs(speed).max() + np.abs(rate).max() * sheet.wheel_base
    assert again_speed == pytest.approx(speed, abs=1e-12 * size)
    assert again_rate == pytest.approx(rate, abs=1e-12 * size / sheet.wheel_base)


def test_known_motions() -> None:
    """The Robotarium's robot: 0.2 m/s straight, 0.4 / 0.11 rad/s on the spot; left is positive."""
    sheet = RobotSheet()
    wheels = np.array([[12.5, 12.5], [-12.5, 12.5], [12.5, -12.5], [0.0, 12.5]])
    speed, rate = body_twist(sheet, wheels)
    assert speed == pytest.approx([0.2, 0.0, 0.0, 0.1])
    assert rate == pytest.approx([0.0, 0.4 / 0.11, -0.4 / 0.11, 0.2 / 0.11])
    assert sheet.top_speed == pytest.approx(0.2)
    assert sheet.top_turn_rate == pytest.approx(0.4 / 0.11)
    assert sheet.traction_force == pytest.approx(0.6 * 0.4 * GRAVITY)


@pytest.mark.parametrize(
    ("shape", "length", "width", "radius"),
    [("circle", 0.2, 0.2, 0.1), ("capsule", 0.4, 0.2, 0.2), ("box", 0.4, 0.3, 0.25)],
)
def test_the_outer_radius_holds_the_outline(shape, length, width, radius) -> None:
    assert RobotSheet(shape=shape, length=length, width=width).outer_radius == pytest.approx(radius)


ANY = st.floats(allow_nan=False)


@given(
    arrays(np.float64, (3, 2), elements=st.floats(-10.0, 10.0)),
    arrays(np.float64, (3, 2), elements=ANY),
    st.floats(0.0, 30.0),
)
def test_slew_stays_within_speed_and_acceleration_and_goes_as_far_as_they_allow(
    current, command, change
) -> None:
    result = slew(current, command, 10.0, change)
    assert (np.abs(result) <= 10.0).all()
    assert (np.abs(result - current) <= change + 1e-12).all()
    # Nearer to the command than any other speed allowed.
    low, high = np.maximum(current - change, -10.0), np.minimum(current + change, 10.0)
    assert (result == np.clip(command, low, high)).all()


@given(st.floats(-1e3, 1e3))
def test_angles_are_folded_into_half_open_half_turns(angle) -> None:
    folded = float(wrap_angle(np.array(angle)))
    assert -math.pi <= folded <= math.pi
    assert math.cos(folded) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(folded) == pytest.approx(math.sin(angle), abs=1e-9)


POSES = arrays(np.float64, (4, 3), elements=st.floats(-10.0, 10.0))


@given(POSES, arrays(np.float64, (4, 2), elements=st.floats(-5.0, 5.0)), st.floats(0.0, 2.0))
def test_a_body_describes_the_arc_that_small_steps_describe(pose, twist, time) -> None:
    speed, rate = twist.T
    x, y, heading = pose.T
    steps = 2000
    for step in range(steps):
        along = heading + rate * time * (step + 0.5) / steps
        x, y = x + speed * time / steps * np.cos(along), y + speed * time / steps * np.sin(along)
    expected = np.stack([x, y, heading + rate * time], axis=-1)
    np.testing.assert_allclose(driven(pose, speed, rate, time), expected, atol=1e-4)


@given(POSES, POSES, POSES)
def test_the_same_motion_from_elsewhere_looks_the_same_to_who_moves(pose, before, now) -> None:
    def seen(place, whence):
        """Return where a place lies ahead and to the left of a pose, and how it is turned against it."""
        apart = place[:, :2] - whence[:, :2]
        cos, sin = np.cos(whence[:, 2]), np.sin(whence[:, 2])
        ahead, left = cos * apart[:, 0] + sin * apart[:, 1], cos * apart[:, 1] - sin * apart[:, 0]
        return np.stack([ahead, left, place[:, 2] - whence[:, 2]], axis=-1)

    moved = moved_on(pose, before, now)
    np.testing.assert_allclose(seen(moved, pose), seen(now, before), atol=1e-9)
