"""Robots that count their wheels' turns know where they are though fixes are late, lost or wild."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from robosim.discretise.noise import SensingConfig, make_sensor
from robosim.discretise.reckoning import PATIENCE, Reckoning
from robosim.discretise.sensing import ExactSensor
from robosim.envs.vector import VectorEnv
from robosim.robot.kinematics import driven, wrap_angle

STEPS, ROBOTS, TRAVEL = 40, 3, 0.06


def paths(seed: int, *start: float) -> np.ndarray:
    """Return poses [decisions, robots, 3] of robots that drive arcs at random; headings are not folded."""
    rng = np.random.default_rng(seed)
    pose = np.tile(np.array(start, float), (ROBOTS, 1))
    out = [pose]
    for _ in range(STEPS):
        pose = driven(pose, rng.uniform(-0.2, 0.2, ROBOTS), rng.uniform(-3.0, 3.0, ROBOTS), 0.3)
        out.append(pose)
    return np.array(out)


def folded(pose: np.ndarray) -> np.ndarray:
    return np.concatenate([pose[..., :2], wrap_angle(pose[..., 2:])], axis=-1)


def assert_same_poses(actual: np.ndarray, expected: np.ndarray) -> None:
    assert_allclose(actual[..., :2], expected[..., :2], atol=1e-9)
    assert_allclose(wrap_angle(actual[..., 2] - expected[..., 2]), 0.0, atol=1e-9)


YES, NO = np.ones(ROBOTS, bool), np.zeros(ROBOTS, bool)


@given(seed=st.integers(0, 1000), latest=st.integers(0, 5), weight=st.floats(0.05, 1.0))
def test_late_and_lost_fixes_cost_nothing_where_wheels_do_not_slip(seed, latest, weight) -> None:
    truth = folded(paths(seed, 1.0, 2.0, 0.5))
    # The wheels count from anywhere, in a frame of their own.
    wheels = paths(seed, 0.0, 0.0, -2.0)
    rng = np.random.default_rng(seed + 1)
    reckoning = Reckoning(weight, TRAVEL, latest)
    assert_same_poses(reckoning.update(truth[0], YES, wheels[0], NO), truth[0])
    for step in range(1, STEPS + 1):
        age = rng.integers(0, min(latest, step) + 1, ROBOTS)
        fresh = rng.random(ROBOTS) < 0.5
        fix = np.where(fresh[:, None], truth[step - age, np.arange(ROBOTS)], 77.0)
        assert_same_poses(reckoning.update(fix, fresh, wheels[step], NO, age), truth[step])


def test_a_wild_fix_is_not_believed_unless_several_in_turn_are_wild() -> None:
    truth = folded(paths(3, 1.0, 2.0, 0.5))
    wheels, far = paths(3, 0.0, 0.0, 0.0), np.array([2.0 * TRAVEL, 0.0, 0.0])
    reckoning = Reckoning(0.5, TRAVEL)
    for step in range(10):
        fix = truth[step] + far * (step == 4)
        assert_same_poses(reckoning.update(fix, YES, wheels[step], NO), truth[step])
    for step in range(10, 10 + PATIENCE):
        assert_same_poses(reckoning.update(truth[step] + far, YES, wheels[step], NO), truth[step])
    step = 10 + PATIENCE
    assert_same_poses(reckoning.update(truth[step] + far, YES, wheels[step], NO), truth[step] + far)


def test_a_robot_that_slips_believes_the_fix() -> None:
    stands, turning = np.tile([1.0, 2.0, 0.3], (ROBOTS, 1)), paths(5, 0.0, 0.0, 0.0)
    slips = np.array([True, False, True])
    reckoning = Reckoning(0.25, np.inf)
    for step in range(5):
        pose = reckoning.update(stands, YES, turning[step], slips)
    assert_same_poses(pose[slips], stands[slips])
    assert np.abs(pose[1] - stands[1]).max() > 0.01


def test_an_estimate_is_nearer_than_its_fixes() -> None:
    truth, wheels = np.tile([1.0, 2.0, 3.1], (2000, 1)), np.zeros((2000, 3))
    rng = np.random.default_rng(0)
    reckoning, errors = Reckoning(0.3, np.inf), []
    noise = rng.normal(0.0, (0.02, 0.02, 0.1), (60, 2000, 3))
    for step in range(60):
        fix, nobody = folded(truth + noise[step]), np.zeros(2000, bool)
        pose = reckoning.update(fix, ~nobody, wheels, nobody)
        errors.append(np.concatenate([(pose - truth)[:, :2], wrap_angle(pose - truth)[:, 2:]], axis=1))
    # Of an exponential average of weight w, the variance is w / (2 - w) of the fixes'.
    expected = np.array([0.02, 0.02, 0.1]) * np.sqrt(0.3 / 1.7)
    assert np.array(errors[-1]).std(axis=0) == pytest.approx(expected, rel=0.06)


def test_without_errors_nothing_is_counted() -> None:
    env = VectorEnv("paper", robots=2, sensing_odometry=0.5)
    assert isinstance(make_sensor(SensingConfig(odometry=0.5), env.world), ExactSensor)


@pytest.mark.parametrize("world", ["physics", "grid"])
def test_robots_know_where_they_are_by_late_fixes(world: str) -> None:
    def error(**options: float) -> float:
        late = VectorEnv("paper", robots=4, num_envs=2, seed=1, world=world, sensing_delay=3, **options)
        late.reset()
        rng, errors = np.random.default_rng(0), []
        for _ in range(60):
            late.step(np.repeat(rng.integers(0, 5, (2, 1)), 4, axis=1))
            off = late.dec_pomdp.believed - late.world.state.pose
            errors.append(np.hypot(off[..., 0], off[..., 1]))
        return float(np.quantile(errors, 0.9))

    assert error(sensing_odometry=0.5) < 0.25 * error()


def test_what_sensors_make_of_it_begins_anew_with_an_episode() -> None:
    env = VectorEnv("paper", robots=3, seed=4, profile="harsh", sensing_odometry=0.3, episode_steps=20)
    actions = np.random.default_rng(2).integers(0, 5, (20, 1, 3))
    first = [env.reset(seed=4), *(env.step(one).final_observation for one in actions)]
    again = [env.reset(seed=4), *(env.step(one).final_observation for one in actions)]
    for one, other in zip(first, again, strict=True):
        assert_array_equal(one, other)


def test_a_robot_that_is_not_seen_goes_on_by_its_wheels_and_is_found_again() -> None:
    truth, wheels = folded(paths(5, 1.0, 2.0, 0.5)), paths(5, 0.0, 0.0, 0.0)
    nowhere = np.full((ROBOTS, 3), np.nan)
    reckoning, late = Reckoning(0.5, TRAVEL), Reckoning(0.5, TRAVEL)
    reckoning.update(truth[0], YES, wheels[0], NO)
    assert np.isnan(late.update(nowhere, YES, wheels[0], NO)).all()
    for step in range(1, 20):
        fix, fresh = (nowhere, step % 2 == 0) if step < 6 else (truth[step], True)
        assert_same_poses(reckoning.update(fix, YES & fresh, wheels[step], NO), truth[step])
        pose = late.update(fix, YES & fresh, wheels[step], NO)
        if step < 6:
            assert np.isnan(pose).all()
        else:
            assert_same_poses(pose, truth[step])
