import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.errors import InputError
from robosim.learning.algorithms.dqn.replay import Batch, Replay


def add(replay, times, envs, robots):
    """Fill with transitions that say who they are: observation (time, env, robot), successor time + 0.5."""
    for time in times:
        grid = np.stack(np.meshgrid(time, np.arange(envs), np.arange(robots), indexing="ij")[:3], -1)[0]
        observation = grid.astype(np.float32)
        successor = observation + np.float32([0.5, 0, 0])
        actions = (grid.sum(axis=-1) % 5).astype(np.int64)
        reward = observation[..., 0] + 100 * observation[..., 2]
        goes_on = (observation[..., 0] % 3 > 0).astype(np.float32)
        replay.add(observation, actions, reward, successor, goes_on)


def sample(replay, transitions, seed=0):
    batch = Batch.reserve(len(replay._pairs), transitions, 3)
    replay.sample(np.random.default_rng(seed), batch)
    return batch


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(4, 20), st.integers(1, 30))
def test_samples_are_whole_transitions_of_the_robot_itself(robots, envs, capacity, decisions):
    replay = Replay(robots, capacity, 3)
    add(replay, range(decisions), envs, robots)
    assert replay.length == min(capacity, decisions * envs)
    batch = sample(replay, 50)
    now, after = batch.observations.numpy(), batch.successors.numpy()
    assert (now[..., 2] == np.arange(robots)[:, None]).all()
    assert (after == now + np.float32([0.5, 0, 0])).all()
    assert (batch.actions[..., 0].numpy() == now.sum(axis=-1) % 5).all()
    assert (batch.rewards[..., 0].numpy() == now[..., 0] + 100 * now[..., 2]).all()
    assert (batch.continues[..., 0].numpy() == (now[..., 0] % 3 > 0)).all()
    oldest = decisions - -(-capacity // envs)
    assert now[..., 0].min() >= oldest


def test_together_all_robots_get_the_same_moments():
    replay = Replay(3, 20, 3)
    add(replay, range(9), 2, 3)
    batch = Batch.reserve(3, 50, 3)
    replay.sample(np.random.default_rng(0), batch, together=True)
    now = batch.observations.numpy()
    assert (now[..., 2] == np.arange(3)[:, None]).all()
    assert (now[..., :2] == now[:1, :, :2]).all()
    assert len(np.unique(now[0, :, :2], axis=0)) > 10


def test_ring_holds_exactly_the_latest():
    replay = Replay(1, 6, 3)
    add(replay, range(10), 1, 1)
    assert sorted(set(sample(replay, 500).observations[0, :, 0].tolist())) == [4, 5, 6, 7, 8, 9]


def test_robots_draw_independently_and_the_same_from_equal_generators():
    replay = Replay(2, 100, 3)
    add(replay, range(100), 1, 2)
    first, again = sample(replay, 32).observations, sample(replay, 32).observations
    assert (first == again).all()
    assert (first[0, :, 0] != first[1, :, 0]).any()
    assert (first != sample(replay, 32, seed=1).observations).any()


def test_sampling_is_uniform():
    replay = Replay(1, 10, 3)
    add(replay, range(10), 1, 1)
    times = sample(replay, 20_000).observations[0, :, 0].numpy()
    assert np.bincount(times.astype(int)) == pytest.approx(np.full(10, 2000), rel=0.1)


def same_samples(one, other):
    mine, yours = sample(one, 40), sample(other, 40)
    return torch.equal(mine.pairs, yours.pairs) and torch.equal(mine.numbers, yours.numbers)


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 3), st.integers(4, 20), st.lists(st.integers(1, 12), min_size=1, max_size=6))
def test_a_replay_is_rebuilt_from_what_was_added_between_checkpoints(envs, capacity, decisions):
    """Round the ring too: it samples the same then, and still does after further transitions."""
    replay, parts, saved, start = Replay(2, capacity, 3), [], 0, 0
    for count in decisions:
        add(replay, range(start, start + count), envs, 2)
        start += count
        first = max(saved, replay.added - replay.length)
        if first > saved:  # overwritten between two checkpoints: all that came before is of no use
            parts, begin = [], first
        elif not parts:
            begin = 0
        parts.append(replay.export(first, replay.added))
        saved = replay.added
    rebuilt = Replay(2, capacity, 3)
    rebuilt.restore(begin, iter(parts))
    assert rebuilt.added == replay.added == start * envs
    assert same_samples(replay, rebuilt)
    for either in (replay, rebuilt):
        add(either, range(start, start + 3), envs, 2)
    assert same_samples(replay, rebuilt)


def test_exported_transitions_are_those_asked_for():
    replay = Replay(2, 6, 3)
    add(replay, range(10), 1, 2)
    part = replay.export(5, 8)
    assert part["observations"][:, :, 0].tolist() == [[5, 6, 7]] * 2
    assert part["successors"][:, :, 0].tolist() == [[5.5, 6.5, 7.5]] * 2
    assert part["rewards"].tolist() == [[5, 6, 7], [105, 106, 107]]
    assert part["actions"].tolist() == [[0, 1, 2], [1, 2, 3]]
    assert part["continues"].tolist() == [[1, 0, 1]] * 2
    for first, last in ((3, 8), (5, 11), (8, 5)):
        with pytest.raises(ValueError, match="held are 4 to 10"):
            replay.export(first, last)


def test_a_replay_of_another_size_or_with_a_gap_is_refused():
    replay = Replay(2, 6, 3)
    add(replay, range(10), 1, 2)
    part = replay.export(4, 10)
    with pytest.raises(InputError, match="start at number 6: 4 is needed"):
        Replay(2, 6, 3).restore(6, [replay.export(6, 10)])
    with pytest.raises(InputError, match=r"\(2, 6, 3\).*they must be .*\(2, 6, 4\)"):
        Replay(2, 6, 4).restore(4, [part])
    for wrong in (part | {"rewards": torch.zeros(())}, {"rewards": part["rewards"]}, {}):
        with pytest.raises(InputError, match="transitions have the shapes"):
            Replay(2, 6, 3).restore(4, [wrong])
    with pytest.raises(InputError, match="they must be"):
        Replay(3, 6, 3).restore(4, [part])


def test_nothing_is_drawn_from_an_empty_replay():
    with pytest.raises(ValueError, match="the replay is empty"):
        sample(Replay(2, 6, 3), 4)


def test_more_environments_than_places_leave_the_latest():
    replay = Replay(1, 4, 3)
    add(replay, [0], 7, 1)
    assert replay.added == 7
    assert replay.length == 4
    assert replay.export(3, 7)["observations"][0, :, 1].tolist() == [3, 4, 5, 6]
