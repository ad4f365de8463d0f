"""Robots move by their wheels alone, as the data sheet says; blocked they stall, pushed hard they slide."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.robot.drivers import Wheels
from robosim.robot.kinematics import moved_on, wrap_angle
from robosim.robot.sheet import GRAVITY
from robosim.world.contacts import ContactKind
from robosim.world.physics import PhysicsWorld

SHAPES = {
    "circle": {},
    "capsule": {"shape": "capsule", "length": 0.15, "width": 0.075, "wheel_base": 0.06, "mass": 0.3},
    "box": {"shape": "box", "length": 0.12, "width": 0.1, "wheel_base": 0.09, "mass": 1.5},
}
HEADINGS = [0.0, 0.7, math.pi / 2, -2.0]
MIDDLE = (2.2, 1.1)


@pytest.mark.parametrize("shape", SHAPES)
def test_straight_at_top_speed_holds_it(bench, shape) -> None:
    for heading in HEADINGS:
        b = bench([(*MIDDLE, heading)], robot=SHAPES[shape])
        sheet, ahead = b.arena.robot, np.array([math.cos(heading), math.sin(heading)])
        top = sheet.max_wheel_speed
        b.drive(top, top, periods=3)
        start, speeds = np.array(b.robot().position), []
        for _ in range(20):
            b.drive(top, top)
            speeds.append(np.array(b.robot().velocity) @ ahead)
        gone = np.array(b.robot().position) - start
        error = gone @ ahead / (2.0 * sheet.top_speed) - 1.0
        astray = abs(gone[0] * ahead[1] - gone[1] * ahead[0])
        worst = np.abs(np.array(speeds) / sheet.top_speed - 1.0).max()
        print(
            f"{shape} heading {heading:.2f}: distance {error:+.2e}, speed off by at most {worst:.2e}, "
            f"{astray:.1e} m off the line"
        )
        assert abs(error) < 0.02
        assert worst < 0.02
        assert astray < 1e-6


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_turning_rate_is_that_of_the_wheels(bench, shape, sense) -> None:
    b = bench([(*MIDDLE, 0.3)], robot=SHAPES[shape])
    sheet = b.arena.robot
    top = sense * sheet.max_wheel_speed
    b.drive(-top, top, periods=5)
    start = b.robot().angle
    b.drive(-top, top, periods=20)
    rate = (b.robot().angle - start) / 2.0
    moved = math.dist(b.robot().position, MIDDLE)
    print(f"{shape}: {rate:.4f} rad/s, sheet {sense * sheet.top_turn_rate:.4f}, moved {moved:.1e} m")
    assert rate == pytest.approx(sense * sheet.top_turn_rate, rel=0.03)
    assert moved < 1e-6


@pytest.mark.parametrize(("left", "right"), [(8.0, 12.5), (12.5, 8.0), (-6.0, -12.5), (3.0, 12.5)])
def test_an_arc_ends_where_kinematics_says(bench, left, right) -> None:
    """Constant wheel speeds drive a circle of radius v / w."""
    b = bench([(*MIDDLE, 0.0)])
    sheet = b.arena.robot
    b.drive(left, right, periods=3)
    x, y, heading = *b.robot().position, b.robot().angle
    b.drive(left, right, periods=10)
    rate = sheet.wheel_radius * (right - left) / sheet.wheel_base
    radius = 0.5 * sheet.wheel_radius * (left + right) / rate
    expected = (
        x + radius * (math.sin(heading + rate) - math.sin(heading)),
        y - radius * (math.cos(heading + rate) - math.cos(heading)),
    )
    error = math.dist(b.robot().position, expected)
    arc = abs(radius * rate)
    print(
        f"arc of radius {radius:.3f} m over {arc:.3f} m: off by {error:.1e} m "
        f"and {b.robot().angle - heading - rate:.1e} rad"
    )
    assert error < 0.02 * arc
    assert b.robot().angle - heading == pytest.approx(rate, rel=0.03)


ABSURD = st.floats(allow_nan=False) | st.sampled_from([1e308, -1e308, math.inf, -math.inf, 0.0, 12.5, 12.51])


@given(st.lists(st.tuples(ABSURD, ABSURD), min_size=1, max_size=8), st.floats(0.1, 1.0))
def test_no_command_exceeds_the_data_sheet(bench, commands, factor) -> None:
    """Wheels obey their top speed and acceleration, and the body never outruns its wheels."""
    b = bench(
        [(*MIDDLE, 0.4)],
        robot={"max_wheel_acceleration": 40.0},
        randomisation={"wheel_speed": [factor, factor]},
    )
    sheet, period = b.arena.robot, b.arena.timing.control_period
    top = factor * sheet.max_wheel_speed
    before = b.world.wheel_speeds
    for left, right in commands:
        b.drive(left, right)
        wheels = b.world.wheel_speeds
        assert np.isfinite(wheels).all()
        assert np.abs(wheels).max() <= top
        assert np.abs(wheels - before).max() <= sheet.max_wheel_acceleration * period * (1 + 1e-12)
        assert b.robot().velocity.length <= top * sheet.wheel_radius * (1 + 1e-9)
        assert abs(b.robot().angular_velocity) <= 2 * top * sheet.wheel_radius / sheet.wheel_base * (1 + 1e-9)
        before = wheels


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("wall", ["east", "south"])
def test_a_robot_against_a_wall_stalls_and_pushes_no_harder_than_its_traction(bench, shape, wall) -> None:
    heading = {"east": 0.0, "south": -math.pi / 2}[wall]
    reach = 0.5 * SHAPES[shape].get("length", 0.11)
    place = {"east": (4.2 - reach - 0.03, 1.1), "south": (2.2, 0.2 + reach + 0.03)}[wall]
    b = bench([(*place, heading)], robot=SHAPES[shape])
    b.decide([0], times=3)
    start = np.array(b.robot().position)
    forces, speeds = [], []
    for _ in range(10):
        b.decide([0])
        of_wall = b.world.contacts.kind == ContactKind.ROBOT_WALL
        assert of_wall.sum() == b.arena.timing.control_steps
        forces.extend(b.world.contacts.impulse[of_wall] / b.arena.timing.substep)
        speeds.append(b.robot().velocity.length)
    limit = b.arena.robot.traction_force
    crept = np.hypot(*(np.array(b.robot().position) - start))
    print(
        f"{shape} at the {wall} wall: speed {max(speeds):.1e} m/s, crept {crept:.1e} m in 3 s, "
        f"force {min(forces):.4f} to {max(forces):.4f} N, traction {limit:.4f} N"
    )
    assert max(speeds) < 1e-3
    assert crept < 1e-3
    assert max(forces) <= limit * 1.001
    assert min(forces) >= limit * 0.99
    overlap = {"east": b.robot().position.x + reach - 4.2, "south": 0.2 + reach - b.robot().position.y}[wall]
    assert -1e-3 < overlap < 1e-3


@pytest.mark.parametrize("direction", [0.0, math.pi / 2, math.pi / 4, -2.5])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_pushed_robot_slides_only_beyond_its_traction(bench, shape, direction) -> None:
    """`direction` is that of the push against the heading; above the limit a = (F - F_traction) / m."""
    ahead = np.array([math.cos(0.4 + direction), math.sin(0.4 + direction)])
    for share in (0.5, 0.95, 1.05, 1.5, 3.0):
        b = bench([(*MIDDLE, 0.4)], robot=SHAPES[shape])
        sheet = b.arena.robot
        b.drive(0.0, 0.0, periods=2)
        force = share * sheet.traction_force
        b.push(b.robot(), tuple(force * ahead), 0.2)
        speed = np.array(b.robot().velocity) @ ahead
        expected = max(0.0, (force - sheet.traction_force) / sheet.mass) * 0.2
        moved = math.dist(b.robot().position, MIDDLE)
        print(
            f"{shape} pushed at {math.degrees(direction):.0f} deg with {share} tractions: "
            f"{speed:.5f} m/s after 0.2 s, expected {expected:.5f}; moved {1000 * moved:.3f} mm"
        )
        assert speed == pytest.approx(expected, rel=0.03, abs=1e-6)
        if share < 1.0:
            assert moved < 1e-6
        assert abs(b.robot().angle - 0.4) < 1e-6


def test_a_pushed_robot_turns_only_beyond_its_wheels_torque(bench) -> None:
    """Two wheels at half the base from the middle: F_traction * base / 2."""
    for share in (0.9, 1.5):
        b = bench([(*MIDDLE, 0.0)])
        sheet, body = b.arena.robot, b.robot()
        limit = sheet.traction_force * 0.5 * sheet.wheel_base
        for _ in range(24):
            body.torque = share * limit
            b.space.step(b.arena.timing.substep)
        expected = max(0.0, share - 1.0) * limit / body.moment * 0.2
        print(f"torque {share} of the limit: {body.angular_velocity:.4f} rad/s, expected {expected:.4f}")
        assert body.angular_velocity == pytest.approx(expected, rel=0.03, abs=1e-6)


def test_a_robot_that_slid_drives_on_from_where_it_is(bench) -> None:
    """Nothing pulls a robot back to where its wheels would have brought it."""
    b = bench([(*MIDDLE, 0.0)])
    b.push(b.robot(), (0.0, 2.0 * b.arena.robot.traction_force), 0.2)
    b.drive(0.0, 0.0, periods=10)
    slid = b.robot().position.y - MIDDLE[1]
    rest = tuple(b.robot().position)
    b.drive(0.0, 0.0, periods=20)
    print(f"slid {slid:.3f} m, then stayed within {math.dist(b.robot().position, rest):.1e} m")
    assert slid > 0.1
    assert math.dist(b.robot().position, rest) < 1e-9


def test_a_robot_speeds_up_no_faster_than_traction_allows(bench) -> None:
    """With wheels that jump to full speed, the ground gives traction * g, and the wheels spin until then."""
    b = bench([(*MIDDLE, 0.0)], robot={"traction": 0.05, "max_wheel_acceleration": 1000.0})
    b.drive(12.5, 12.5)
    expected = 0.05 * GRAVITY * b.arena.timing.control_period
    print(f"{b.robot().velocity.x:.5f} m/s after a control period, expected {expected:.5f}")
    assert b.robot().velocity.x == pytest.approx(expected, rel=0.02)


def test_a_mirrored_world_moves_as_the_mirror_image(bench) -> None:
    """Left and right are alike: of two robots meeting at an angle, pushing a pellet, too."""
    rng = np.random.default_rng(3)
    plain = bench([(1.6, 1.0, 0.2), (2.6, 1.3, 3.0)])
    other = bench([(1.6, 2.2 - 1.0, -0.2), (2.6, 2.2 - 1.3, -3.0)])
    plain.put_pellet((1.75, 1.05))
    other.put_pellet((1.75, 2.2 - 1.05))
    worst = 0.0
    for _ in range(40):
        wheels = rng.uniform(0.0, 12.5, (1, 2, 2))
        plain.world.drive(wheels)
        other.world.drive(wheels[..., ::-1].copy())
        for index in range(2):
            one, two = plain.robot(index), other.robot(index)
            worst = max(
                worst, abs(one.position.x - two.position.x), abs(one.position.y + two.position.y - 2.2)
            )
            worst = max(worst, abs(one.angle + two.angle))
    print(f"mirror images differ by at most {worst:.1e} after 4 s")
    assert worst < 1e-6


def test_wheels_that_do_not_slip_count_how_far_a_robot_has_come() -> None:
    world = PhysicsWorld(load_arena("paper"), 1, 1, "wheels-9")
    world.count_turns()
    world.reset([np.random.SeedSequence(3)])
    start, state = world.state.pose.copy(), world.state
    rng = np.random.default_rng(1)
    for _ in range(10):
        world.step(rng.integers(0, 9, (1, 1)), np.zeros((1, 1), np.int8))
        if state.touched.any():
            break
        reckoned = moved_on(start, np.zeros_like(start), state.odometry)
        off = reckoned - state.pose
        # The solver moves bodies by the velocity before a substep: at each change of speed they lag.
        assert np.hypot(off[0, 0, 0], off[0, 0, 1]) < 0.01
        assert abs(wrap_angle(off[0, 0, 2])) < 0.1
    assert np.hypot(*(state.pose - start)[0, 0, :2]) > 0.05


def test_wheels_that_slip_count_on_and_counting_changes_nothing() -> None:
    worlds = [PhysicsWorld(load_arena("paper"), 1, 1, "wheels") for _ in range(2)]
    worlds[0].count_turns()
    for world in worlds:
        world.reset([np.random.SeedSequence(3)])
        for _ in range(60):
            world.step(np.full((1, 1), Wheels.FORWARD), np.zeros((1, 1), np.int8))
    counted, plain = (world.state for world in worlds)
    assert np.array_equal(counted.pose, plain.pose)
    assert not plain.odometry.any()
    # It has stood at a wall since, its wheels turning.
    turned = counted.odometry[0, 0, 0]
    assert turned == pytest.approx(60 * worlds[0].travel, rel=0.02)
    assert turned > 3.0
