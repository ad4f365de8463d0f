"""The least distance between robots: against small steps along the path, and metered in the worlds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.control.controller import make_controller
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.world.spacing import closest_on_the_path, to_nearest

FORWARD = 0


@given(st.integers(0, 2**32 - 1), st.integers(2, 6))
def test_the_closest_point_of_a_path_is_that_of_many_small_steps(seed: int, robots: int) -> None:
    rng = np.random.default_rng(seed)
    before = rng.uniform(0.0, 1.0, (2, robots, 3))
    after = before + rng.normal(0.0, 0.2, (2, robots, 3))
    after[0, 0] = before[0, 0]
    got = closest_on_the_path(before, after)
    for env, robot in np.ndindex(2, robots):
        shares = np.linspace(0.0, 1.0, 2001)[:, None]
        here = before[env, robot, :2] * (1 - shares) + after[env, robot, :2] * shares
        least = np.inf
        for other in range(robots):
            if other != robot:
                there = before[env, other, :2] * (1 - shares) + after[env, other, :2] * shares
                least = min(least, np.hypot(*(here - there).T).min())
        assert got[env, robot] == pytest.approx(least, abs=1e-3)
        assert got[env, robot] <= least + 1e-12


def test_one_alone_is_infinitely_far_from_others() -> None:
    assert to_nearest(np.zeros((3, 1, 3))).tolist() == [[np.inf]] * 3


def test_two_that_pass_are_closest_between_two_looks() -> None:
    before = np.array([[[0.0, 0.0, 0.0], [1.0, 0.25, 0.0]]])
    after = np.array([[[1.0, 0.0, 0.0], [0.0, 0.25, 0.0]]])
    assert closest_on_the_path(before, after).tolist() == [[0.25, 0.25]]
    assert to_nearest(after).min() > 1.0


def test_robots_that_drive_at_each_other_end_a_diameter_apart(bench) -> None:
    b = bench([(1.0, 1.1, 0.0), (1.6, 1.1, np.pi)])
    b.world.meter()
    assert b.world.closest.tolist() == [[pytest.approx(0.6)] * 2]
    b.drive(12.5, 12.5, 60)
    b.drive(-12.5, -12.5, 10)
    touching = b.arena.robot.length
    assert b.world.closest[0].tolist() == [pytest.approx(touching, abs=0.02)] * 2
    assert to_nearest(b.world.state.pose).min() > touching + 0.05


@pytest.mark.parametrize("world", ["physics", "grid"])
def test_an_episode_begins_anew_and_without_metering_nothing_is_known(world) -> None:
    env = VectorEnv("paper", world=world, robots=4, num_envs=2, seed=[5, 6], episode_steps=40)
    keeper = make_controller("lanes")
    observation = env.reset()
    keeper.reset(env)
    observation = env.step(keeper.act(env, observation)).observation
    assert np.isinf(env.world.closest).all()
    env.world.meter()
    least = to_nearest(env.world.state.pose)
    for _ in range(30):
        observation = env.step(keeper.act(env, observation)).observation
        least = np.minimum(least, to_nearest(env.world.state.pose))
        assert (env.world.closest <= least).all()
        assert (env.world.closest > 0.0).all()
    assert env.frame(1).closest.tolist() == env.world.closest[1].tolist()
    env.reset()
    assert env.world.closest.tolist() == to_nearest(env.world.state.pose).tolist()


@pytest.mark.parametrize("actions", ["cardinal", "wheels"])
def test_bodies_keep_their_distance_whatever_they_are_told(bench, actions) -> None:
    """On an open floor, in whose middle no pellet lies: driven bodies do as the driver plans."""
    rng = np.random.default_rng(8)
    poses = [(1.2 + 0.3 * x, 0.8 + 0.3 * y, rng.uniform(-3.0, 3.0)) for x in range(4) for y in range(2)]
    b = bench(poses, actions=actions, keep_distance=0.2)
    b.world.meter()
    held_back = 0
    keep = np.zeros((1, 8), dtype=np.int8)
    for _ in range(60):
        b.world.step(rng.integers(0, 5, (1, 8)), keep)
        held_back += int(b.world.state.refused.sum())
    assert 0.19 < b.world.closest.min() < 0.205
    assert held_back > 0


def test_a_team_that_keeps_its_distance_touches_nobody_and_is_blocked_where_it_is_held_back() -> None:
    env = VectorEnv("robotarium", robots=4, seed=[2], keep_distance=0.3)
    env.reset()
    env.world.meter()
    blocked = 0
    for _ in range(60):
        transition = env.step(np.full((1, 4), 0))
        assert not env.world.state.touched[0].any()
        assert (transition.blocked >= env.world.state.refused).all()
        blocked += int(env.world.state.refused.sum())
    assert blocked > 0


def test_robots_that_keep_a_distance_start_at_it() -> None:
    env = VectorEnv("robotarium", robots=20, num_envs=20, seed=7, keep_distance=0.17)
    crowded = VectorEnv("robotarium", robots=20, num_envs=20, seed=7)
    for episode in range(3):
        env.reset()
        crowded.reset()
        poses = env.world.state.pose
        assert to_nearest(poses).min() >= 0.17, episode
        assert to_nearest(crowded.world.state.pose).min() < 0.17, "or nothing is shown"
        places = env.arena.start_places
        assert all((places == pose[:2]).all(axis=1).any() for pose in poses.reshape(-1, 3))


def test_a_full_home_is_filled_as_close_as_it_goes_and_beyond_that_refused() -> None:
    env = VectorEnv("paper", robots=35)
    with pytest.raises(InputError) as caught:
        VectorEnv("paper", robots=35, keep_distance=0.15)
    sentence = str(caught.value)
    assert sentence.startswith("robots is 35, but must be a whole number from 1 to ")
    most = int(sentence.split("from 1 to ")[1].split(",")[0])
    assert sentence.endswith("the room in arena 'paper' at keep_distance 0.15.")
    assert 1 < most < env.arena.capacity
    full = VectorEnv("paper", robots=most, num_envs=10, seed=3, keep_distance=0.15)
    full.reset()
    assert to_nearest(full.world.state.pose).min() >= 0.15


def test_in_the_grid_a_distance_up_to_a_cell_is_kept_by_itself_and_no_other() -> None:
    with pytest.raises(InputError, match="keep_distance is 0.2, but must be at most 0.15 in the grid world"):
        VectorEnv("paper", world="grid", keep_distance=0.2)
    plain, keeping = (VectorEnv("paper", world="grid", robots=8, keep_distance=keep) for keep in (None, 0.15))
    np.testing.assert_array_equal(plain.reset(3), keeping.reset(3))
    rng = np.random.default_rng(0)
    for _ in range(50):
        actions = rng.integers(0, 5, (1, 8))
        np.testing.assert_array_equal(plain.step(actions).observation, keeping.step(actions).observation)
        assert to_nearest(keeping.world.state.pose).min() >= 0.15 - 1e-9


@pytest.mark.parametrize("traction", [0.05, 0.1, 0.6])
def test_on_slippery_ground_robots_brake_sooner(traction) -> None:
    """A barrier that brakes as hard as the wheels could let them come as near as 0.14 m at 0.05."""
    poses = "[start]\nposes = [[1.5, 0.675, 0.0], [2.4, 0.675, 3.14159265]]\n\n"
    robot = f"[robot]\ntraction = {traction}\n\n"
    text = load_arena("paper").text.replace("[pellets]", f"{poses}{robot}[pellets]")
    env = VectorEnv(text, robots=2, keep_distance=0.2)
    env.reset()
    env.world.meter()
    for _ in range(30):
        env.step([[3, 2]])
    assert 0.185 < env.world.closest.min() < 0.205
