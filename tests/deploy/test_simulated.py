"""Teams in place of real ones: what they are told under a profile is what evaluation tells them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import load_policy
from robosim.deploy import Controller
from robosim.deploy.simulated import SimulatedRobots, make_stand_in
from robosim.envs.profile import ProfileConfig
from robosim.errors import InputError


@pytest.mark.parametrize("odometry", [None, 0.3])
def test_under_a_profile_they_move_as_in_an_evaluation_under_it(odometry: float | None) -> None:
    """To the bit at first; then steering by a fix, and by what lies between fix and truth, round apart."""
    policy = load_policy("paper-2")
    chooser = LearnedController(policy, "paper-2")
    env = environment_for(chooser, seed=2, profile="robotarium", odometry=odometry)
    observation = env.reset()
    chooser.reset(env)
    controller, robots = Controller(policy, max_age=2.0), SimulatedRobots(env.config, env.seeds[0])
    assert robots.world.drawn[0].table() == env.drawn[0].table()
    for _ in range(40):
        actions = chooser.act(env, observation)
        for period in range(env.arena.timing.control_steps):
            readings = robots.readings()
            if period == 0:
                assert_array_equal(readings.pose, env.dec_pomdp.believed[0])
            command = controller.step(readings, robots.now)
            robots.obey(command)
        observation = env.step(actions).observation
        assert_allclose(robots.world.state.pose, env.world.state.pose, atol=1e-9)
    assert np.abs(robots.world.state.pose[0] - robots.readings().pose).max() > 1e-4


def test_a_pose_is_as_old_as_its_fix() -> None:
    profile = ProfileConfig.from_table({"sensing": {"delay": 1, "dropout": 0.5}}, "profile")
    robots = make_stand_in("pymunk", "paper", robots=4, seed=1, profile=profile)
    controller = Controller(load_policy("paper-4"), max_age=60.0)
    truth, ages = [], []
    for period in range(60):
        readings = robots.readings()
        if period % 3 == 0:
            truth.append(robots.world.state.pose[0].copy())
            age = np.rint((robots.now - readings.time) / 0.3).astype(int)
            ages.append(age)
            for robot in range(4):
                assert_array_equal(readings.pose[robot], truth[-1 - age[robot]][robot])
        else:
            assert_allclose(robots.now - readings.time, 0.3 * ages[-1], atol=1e-9)
        robots.obey(controller.step(readings, robots.now))
    assert min(map(min, ages[2:])) == 1
    assert max(map(max, ages)) > 3


def test_an_engine_that_nobody_knows_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        make_stand_in("bullet", "paper")
    assert str(caught.value) == 'engine is "bullet", but must be pymunk or mujoco.'


@pytest.mark.parametrize("engine", ["pymunk", "mujoco"])
def test_a_stand_in_is_what_it_is_asked_for(engine) -> None:
    if engine == "mujoco":
        pytest.importorskip("mujoco")
    robots = make_stand_in(engine, "robotarium", robots=3, seed=4, profile="robotarium")
    assert robots.arena.name == "robotarium"
    assert robots.config.profile.name == "robotarium"
    assert robots.readings().robots == robots.world.robots == 3
    assert (robots.world.drawn[0].wheel_gain != 1.0).all()
