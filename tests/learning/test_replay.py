import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.learning.replay import Replay


def add(replay, times, envs, robots):
    """Fill with transitions that say who they are: observation (time, env, robot), successor time + 0.5."""
    for time in times:
        grid = np.stack(np.meshgrid(time, np.arange(envs), np.arange(robots), indexing="ij")[:3], -1)[0]
        observation = grid.astype(np.float32)
        successor = observation + np.float32([0.5, 0, 0])
        actions = (grid.sum(axis=-1) % 5).astype(np.int64)
        replay.add(observation, actions, observation[..., 0] + 100 * observation[..., 2], successor)


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(4, 20), st.integers(1, 30))
def test_samples_are_whole_transitions_of_the_robot_itself(robots, envs, capacity, decisions):
    replay = Replay(robots, capacity, 3)
    add(replay, range(decisions), envs, robots)
    assert replay.length == min(capacity, decisions * envs)
    observations, actions, rewards = replay.sample(50, np.random.default_rng(0))
    now, after = observations[:, 0::2].numpy(), observations[:, 1::2].numpy()
    assert (now[..., 2] == np.arange(robots)[:, None]).all()
    assert (after == now + np.float32([0.5, 0, 0])).all()
    assert (actions[..., 0].numpy() == now.sum(axis=-1) % 5).all()
    assert (rewards.numpy() == now[..., 0] + 100 * now[..., 2]).all()
    oldest = decisions - -(-capacity // envs)
    assert now[..., 0].min() >= oldest


def test_ring_holds_exactly_the_latest():
    replay = Replay(1, 6, 3)
    add(replay, range(10), 1, 1)
    observations, _, _ = replay.sample(500, np.random.default_rng(0))
    assert sorted(set(observations[0, 0::2, 0].tolist())) == [4, 5, 6, 7, 8, 9]


def test_robots_draw_independently_and_the_same_from_equal_generators():
    replay = Replay(2, 100, 3)
    add(replay, range(100), 1, 2)
    first = replay.sample(32, np.random.default_rng(5)).observations
    again = replay.sample(32, np.random.default_rng(5)).observations
    assert (first == again).all()
    assert (first[0, 0::2, 0] != first[1, 0::2, 0]).any()


def test_sampling_is_uniform():
    replay = Replay(1, 10, 3)
    add(replay, range(10), 1, 1)
    times = replay.sample(20_000, np.random.default_rng(0)).observations[0, 0::2, 0].numpy()
    assert np.bincount(times.astype(int)) == pytest.approx(np.full(10, 2000), rel=0.1)
