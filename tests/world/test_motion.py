"""What differs from robot to robot is as large as asked for, stays within the data sheet, and repeats."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from robosim.arena import load_arena
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.robot.sheet import GRAVITY
from robosim.world.factory import make_world
from robosim.world.motion import EXACT, LateCommands, MotionConfig, MotionDraws, draw_motion

MIDDLE = (2.0, 1.0, 0.0)
NIMBLE = {"max_wheel_acceleration": 1e5, "traction": 5.0}
"""A data sheet that lets a robot have any speed at once."""
WIDE = MotionConfig(
    wheel_gain=(0.8, 1.1), wheel_mismatch=(-0.2, 0.1), motor_lag=(0.0, 0.2), traction=(0.5, 1.5),
    robot_mass=(0.7, 1.2), pellet_mass=(0.5, 2.0), pellet_friction=(0.25, 1.0), latency=(0.01, 0.11),
)  # fmt: skip


def seed(number: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(number, spawn_key=(0,))


def test_draws_lie_evenly_in_their_ranges() -> None:
    draws = [draw_motion(WIDE, 5, seed(number)) for number in range(400)]
    for name in ("motor_lag", "traction", "robot_mass", "latency"):
        low, high = getattr(WIDE, name)
        found = np.concatenate([getattr(one, name) for one in draws])
        assert ((found >= low) & (found <= high)).all()
        assert found.mean() == pytest.approx(0.5 * (low + high), abs=0.03 * (high - low))
        assert found.std() == pytest.approx((high - low) / 12**0.5, rel=0.05)
    for name in ("pellet_mass", "pellet_friction"):
        low, high = getattr(WIDE, name)
        found = np.array([getattr(one, name) for one in draws])
        assert ((found >= low) & (found <= high)).all()
        assert found.mean() == pytest.approx(0.5 * (low + high), abs=0.06 * (high - low))
    gains = np.concatenate([one.wheel_gain for one in draws])
    middle, mismatch = gains.mean(axis=1), (gains[:, 1] - gains[:, 0]) / gains.mean(axis=1)
    assert middle.min() >= 0.8 - 1e-12
    assert middle.max() <= 1.1 + 1e-12
    assert mismatch.min() >= -0.2 - 1e-12
    assert mismatch.max() <= 0.1 + 1e-12
    assert mismatch.mean() == pytest.approx(-0.05, abs=0.01)


def test_a_range_changes_its_own_draws_and_no_others() -> None:
    first = draw_motion(WIDE, 3, seed(1)).table()
    other = draw_motion(WIDE.changed(traction=(1.0, 1.0)), 3, seed(1)).table()
    assert other.pop("traction") == [1.0, 1.0, 1.0]
    del first["traction"]
    assert first == other
    assert draw_motion(WIDE, 3, seed(2)).table() != draw_motion(WIDE, 3, seed(1)).table()


def test_what_one_robot_has_is_its_part_of_the_table() -> None:
    drawn = draw_motion(WIDE, 3, seed(1))
    own = drawn.of_robot(2)
    assert own["wheel_gain"] == drawn.wheel_gain[2].tolist()
    assert own["latency"] == drawn.latency[2]
    assert own["pellet_mass"] == drawn.pellet_mass


def test_bodies_and_the_forces_that_hold_them_follow_the_draws(bench) -> None:
    made = bench([MIDDLE, (1.0, 1.0, 0.0)], motion=WIDE)
    drawn, sheet, pellets = made.world.drawn[0], made.arena.robot, made.arena.pellets
    for robot in (0, 1):
        body = made.robot(robot)
        mass = sheet.mass * drawn.robot_mass[robot]
        assert body.mass == pytest.approx(mass)
        grip = sheet.traction * drawn.traction[robot] * mass * GRAVITY
        assert sorted(joint.max_force for joint in body.constraints) == pytest.approx(
            sorted([grip, 0.5 * sheet.wheel_base * grip])
        )
    body = made.pellet()
    assert body.mass == pytest.approx(pellets.mass * drawn.pellet_mass)
    held = pellets.friction * drawn.pellet_friction * body.mass * GRAVITY
    assert max(joint.max_force for joint in body.constraints) == pytest.approx(held)


def test_gain_and_mismatch_turn_a_straight_command_into_an_arc(bench) -> None:
    motion = MotionConfig(wheel_gain=(0.8, 0.8), wheel_mismatch=(0.1, 0.1))
    made = bench([MIDDLE], motion=motion)
    made.drive(5.0, 5.0, periods=3)
    assert_allclose(made.world.wheel_speeds[0, 0], [5.0 * 0.8 * 0.95, 5.0 * 0.8 * 1.05])
    sheet = made.arena.robot
    rate = 5.0 * 0.8 * 0.1 * sheet.wheel_radius / sheet.wheel_base
    assert made.robot().angular_velocity == pytest.approx(rate, rel=1e-3)


def test_a_motor_with_lag_follows_a_step_as_a_first_order_system_does(bench) -> None:
    made = bench([MIDDLE], motion=MotionConfig(motor_lag=(0.15, 0.15)), robot={"max_wheel_acceleration": 1e4})
    period = made.arena.timing.control_period
    for count in range(1, 6):
        made.drive(6.0, 3.0)
        share = 1.0 - np.exp(-count * period / 0.15)
        assert_allclose(made.world.wheel_speeds[0, 0], [6.0 * share, 3.0 * share], rtol=1e-9)


@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_no_gain_takes_wheels_beyond_the_data_sheet(bench, lag) -> None:
    motion = MotionConfig(wheel_gain=(2.0, 2.0), wheel_mismatch=(0.5, 0.5), motor_lag=(lag, lag))
    made = bench([MIDDLE], motion=motion, robot={"max_wheel_acceleration": 40.0})
    sheet, before = made.arena.robot, np.zeros(2)
    for speed in (12.5, 12.5, 12.5, 12.5, -12.5, -12.5, 1e6):
        made.drive(speed, speed)
        now = made.world.wheel_speeds[0, 0].copy()
        assert (np.abs(now) <= sheet.max_wheel_speed).all()
        assert (np.abs(now - before) <= 40.0 * made.arena.timing.control_period * (1 + 1e-9)).all()
        before = now
    assert np.hypot(*made.robot().velocity) <= sheet.top_speed * (1 + 1e-9)


def test_commands_come_after_exactly_so_many_physics_steps(bench) -> None:
    made = bench([MIDDLE], motion=MotionConfig(latency=(0.15, 0.15)), robot=NIMBLE)
    substep = made.arena.timing.substep
    assert round(0.15 / substep) == 18
    places = []
    for _ in range(4):
        made.drive(10.0, 10.0)
        places.append(made.robot().position.x)
    # The first command was sent at 0 and arrives with step 18 of 12 a period.
    speed = 10.0 * made.arena.robot.wheel_radius
    assert places[0] == MIDDLE[0]
    assert places[1] == pytest.approx(MIDDLE[0] + 6 * substep * speed, abs=1.5 * substep * speed)
    assert places[3] - places[2] == pytest.approx(12 * substep * speed, rel=1e-6)


def test_robots_follow_the_newest_command_that_has_arrived() -> None:
    """Against a list of all commands that were ever sent, looked through anew in every step."""
    config, robots, period, step = MotionConfig(latency=(0.0, 0.3), jitter=0.2), 4, 3, 0.05
    seeds = [seed(4), seed(5)]
    draws = [draw_motion(config, robots, one) for one in seeds]
    late = LateCommands(config, draws, seeds, step, period, np.full((2, robots), -1))
    chance = LateCommands(config, draws, seeds, step, period, np.full((2, robots), -1))._chance
    assert chance is not None
    sent: list[tuple[np.ndarray, int]] = []
    overtaken = 0
    for now in range(120):
        if now % period == 0:
            late.send(np.full((2, robots), now), now)
            delay = np.stack([one.latency for one in draws]) + 0.2 * chance.next()
            sent.append((now + np.rint(delay / step), now))
        expected = np.full((2, robots), -1)
        for arrival, command in sent:
            expected[arrival <= now] = command
        assert_array_equal(late.received(now), expected)
        overtaken += len(sent) > 1 and bool((sent[-1][0] < sent[-2][0]).any())
    assert overtaken > 0


def plain_draws(robots: int, latency: float) -> MotionDraws:
    return draw_motion(MotionConfig(latency=(latency, latency)), robots, seed(0))


def test_on_the_grid_robots_do_what_was_decided_so_many_decisions_ago() -> None:
    arena = load_arena("paper")
    late = make_world("grid", arena, 3, 2, motion=MotionConfig(latency=(1.5, 1.5)))
    exact = make_world("grid", arena, 3, 2)
    decisions = round(1.5 / late.arena.timing.decision_period)
    assert decisions == 2
    seeds = [seed(1), seed(2)]
    late.reset(seeds)
    exact.reset(seeds)
    actions = np.random.default_rng(0).integers(0, 4, (40, 2, 3))
    keep = np.zeros((2, 3), dtype=np.int8)
    shown = [exact.state.pose.copy()] * decisions
    exact.step(np.full((2, 3), 4), keep)
    exact.step(np.full((2, 3), 4), keep)
    for chosen in actions:
        late.step(chosen, keep)
        assert_array_equal(late.state.pose, shown[-decisions])
        exact.step(chosen, keep)
        shown.append(exact.state.pose.copy())


def test_the_grid_refuses_what_means_nothing_there() -> None:
    for name in MotionConfig.model_fields:
        if name in ("latency", "jitter"):
            continue
        plain = list(getattr(EXACT, name))
        with pytest.raises(InputError) as refusal:
            VectorEnv("paper", world="grid", profile={"motion": {name: (0.5, 0.75)}})
        assert str(refusal.value) == (
            f"motion.{name} is [0.5, 0.75], but must be {plain} in the grid world, "
            "whose robots have neither wheels nor weight."
        )


def test_extremes_that_files_may_hold_are_nothing_that_the_physics_library_breaks_at() -> None:
    for end in (0.1, 10.0):
        ends = (end, end)
        motion = MotionConfig(traction=ends, robot_mass=ends, pellet_mass=ends, pellet_friction=ends)
        text = load_arena("paper").text + (
            f"\n[randomisation]\nrobot_mass = [{end}, {end}]\ntraction = [{end}, {end}]\n"
            f"pellet_mass = [{end}, {end}]\npellet_friction = [{end}, {end}]\n"
        )
        world = make_world("physics", load_arena(text), 8, 1, motion=motion)
        world.reset([seed(0)])
        for _ in range(10):
            world.step(np.full((1, 8), 3), np.ones((1, 8), dtype=np.int8))
        assert np.isfinite(world.state.pose).all()
        assert np.isfinite(world.state.pellets).all()


def test_an_exact_world_draws_what_it_always_drew(bench) -> None:
    made = bench([MIDDLE])
    assert made.world.motion == EXACT
    assert made.robot().mass == made.arena.robot.mass
    assert made.world._motors is None
