import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from robosim.discretise.observation import MoveGains
from robosim.errors import InputError
from robosim.learning.algorithms.dqn.learner import DqnSettings, StackedDoubleDQN
from robosim.learning.networks import NetworkShape
from tests.learning.plain import plain_networks

SHAPE = NetworkShape(robots=3, inputs=6, hidden=(16, 16, 16), outputs=5)
SETTINGS = DqnSettings(discount=0.9, batch_size=8, target_interval=3, replay_capacity=50, reward_scale=0.5)


def filled(
    shape=SHAPE, settings=SETTINGS, seed=0, reward_of_last=1.0, device="cpu", precision="float32", ends=0.0
):
    learner = StackedDoubleDQN(shape, settings, np.random.SeedSequence(seed), device, precision)
    rng = np.random.default_rng(7)
    for _ in range(20):
        observation, successor = rng.random((2, 2, shape.robots, shape.inputs), np.float32)
        reward = rng.random((2, shape.robots), np.float32)
        reward[:, -1] *= reward_of_last
        actions = rng.integers(5, size=reward.shape)
        goes_on = (rng.random(reward.shape) >= ends).astype(np.float32) if ends else None
        learner.replay.add(observation, actions, reward, successor, goes_on)
    return learner


@pytest.mark.parametrize("normalised", [False, True])
@pytest.mark.parametrize("batch_size", [8, 500, 1500])
def test_updates_equal_plain_double_dqn_with_autograd(batch_size, normalised):
    """Whether the robots are taken all together, two and one, or one by one."""
    shape = replace(SHAPE, normalised=normalised)
    learner = filled(shape, settings=replace(SETTINGS, batch_size=batch_size))
    assert len(learner._blocks) == {8: 1, 500: 2, 1500: 3}[batch_size]
    online, target = plain_networks(learner.parameters), plain_networks(learner.target)
    optimisers = [torch.optim.Adam(network.parameters(), lr=1e-3) for network in online]
    for update in range(1, 8):
        learner.update(1e-3)
        drawn = learner._batch
        for robot in range(SHAPE.robots):
            now, after = drawn.observations[robot], drawn.successors[robot]
            with torch.no_grad():
                best = online[robot](after).argmax(dim=1, keepdim=True)
                goal = 0.5 * drawn.rewards[robot] + 0.9 * target[robot](after).gather(1, best)
            loss = (online[robot](now).gather(1, drawn.actions[robot]) - goal).square().mean()
            assert float(learner.loss()[robot]) == pytest.approx(loss.item(), rel=1e-3)
            optimisers[robot].zero_grad()
            loss.backward()
            optimisers[robot].step()
            if update % 3 == 0:
                target[robot].load_state_dict(online[robot].state_dict())
        expected = plain_networks(learner.parameters)
        for ours, theirs in zip(expected, online, strict=True):
            for one, other in zip(ours.parameters(), theirs.parameters(), strict=True):
                torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


MASKED = replace(SETTINGS, gains=MoveGains(0, 5, 4))
WIDE = replace(SHAPE, inputs=10)


def some_moves_blocked(learner):
    """Block about a quarter of the moves in what is held in the replay."""
    numbers = learner.replay._pairs
    blocked = torch.rand(numbers[..., :4].shape, generator=torch.Generator().manual_seed(3)) < 0.25
    numbers[..., 0:4][blocked] = numbers[..., 5:9][blocked] = -1.0
    # A loss of a cell toward one goal alone blocks nothing.
    numbers[..., 0:4][torch.rand(blocked.shape, generator=torch.Generator().manual_seed(4)) < 0.25] = -1.0


def test_targets_follow_the_best_move_that_is_open():
    learner = filled(WIDE, MASKED)
    some_moves_blocked(learner)
    online, target = plain_networks(learner.parameters), plain_networks(learner.target)
    learner.update(1e-3)
    drawn, differ = learner._batch, 0
    for robot in range(WIDE.robots):
        errors = []
        for k in range(MASKED.batch_size):
            now, after = drawn.observations[robot, k], drawn.successors[robot, k]
            with torch.no_grad():
                values, valued, acted = online[robot](after), target[robot](after), online[robot](now)
            still_open = [a for a in range(4) if not (after[a] == -1.0 and after[5 + a] == -1.0)] + [4]
            best = max(still_open, key=lambda action, values=values: float(values[action]))
            differ += best != int(values.argmax())
            goal = 0.5 * drawn.rewards[robot, k, 0] + 0.9 * valued[best]
            errors.append(float(acted[drawn.actions[robot, k, 0]] - goal) ** 2)
        assert float(learner.loss()[robot]) == pytest.approx(np.mean(errors), rel=1e-4)
    assert differ > 0


def test_the_greedy_choose_open_moves_only():
    learner, free = filled(WIDE, MASKED), filled(WIDE)
    observation = np.random.default_rng(0).uniform(0, 1, (400, 3, 10)).astype(np.float32)
    blocked = np.random.default_rng(1).random((400, 3, 4)) < 0.5
    observation[..., 0:4][blocked] = observation[..., 5:9][blocked] = -1.0
    chosen, wished = learner.act(observation, 0.0), free.act(observation, 0.0)
    shut = np.concatenate([blocked, np.zeros((400, 3, 1), bool)], axis=2)
    assert not np.take_along_axis(shut, chosen[..., None], axis=2).any()
    wishes_hold = ~np.take_along_axis(shut, wished[..., None], axis=2)[..., 0]
    assert 0 < wishes_hold.sum() < wishes_hold.size
    assert (chosen == wished)[wishes_hold].all()


def test_nothing_is_expected_behind_the_end_of_a_task():
    learner = filled(ends=0.4)
    online, target = plain_networks(learner.parameters), plain_networks(learner.target)
    learner.update(1e-3)
    drawn, ended = learner._batch, 0
    for robot in range(SHAPE.robots):
        errors = []
        for k in range(SETTINGS.batch_size):
            now, after = drawn.observations[robot, k], drawn.successors[robot, k]
            with torch.no_grad():
                follows = target[robot](after)[online[robot](after).argmax()]
                value = online[robot](now)[drawn.actions[robot, k, 0]]
            over = float(drawn.continues[robot, k, 0]) == 0.0
            ended += over
            goal = 0.5 * drawn.rewards[robot, k, 0] + (0.0 if over else 0.9 * follows)
            errors.append(float(value - goal) ** 2)
        assert float(learner.loss()[robot]) == pytest.approx(np.mean(errors), rel=1e-4)
    assert 0 < ended < SHAPE.robots * SETTINGS.batch_size


def test_equal_seeds_give_equal_bits():
    one, other = filled(seed=4), filled(seed=4)
    for _ in range(20):
        one.update(1e-3)
        other.update(1e-3)
    assert torch.equal(one.parameters.flat, other.parameters.flat)
    assert not torch.equal(one.parameters.flat, filled(seed=5).parameters.flat)


def test_nothing_passes_from_one_learner_to_another():
    one, other = filled(reward_of_last=1.0), filled(reward_of_last=-3.0)
    for _ in range(10):
        one.update(1e-3)
        other.update(1e-3)
    for mine, yours in zip(one.parameters.weights, other.parameters.weights, strict=True):
        assert torch.equal(mine[:2], yours[:2])
        assert not torch.equal(mine[2], yours[2])


def test_target_is_copied_every_interval_only():
    learner = filled()
    for update in range(1, 8):
        before = learner.target.flat.clone()
        learner.update(1e-3)
        copied = torch.equal(learner.target.flat, learner.parameters.flat)
        assert copied == (update % 3 == 0)
        assert copied or torch.equal(learner.target.flat, before)


def test_acts_greedily_without_exploration_and_evenly_with_nothing_else():
    learner = filled()
    observation = np.random.default_rng(0).random((2000, 3, 6), np.float32)
    assert (learner.act(observation, 0.0) == learner.values(observation).argmax(axis=-1)).all()
    drawn = learner.act(observation, 1.0)
    assert drawn.dtype == np.int64
    assert np.bincount(drawn.ravel(), minlength=5) == pytest.approx(np.full(5, 1200), rel=0.15)
    mixed = learner.act(observation, 0.25) != learner.act(observation, 0.0)
    assert mixed.mean() == pytest.approx(0.25 * 0.8, abs=0.02)


def test_an_update_leaves_subnormal_numbers_to_others():
    filled().update(1e-3)
    smallest = np.array([np.finfo(np.float32).smallest_subnormal])
    assert (smallest * np.float32(1.0))[0] > 0.0
    assert (torch.from_numpy(smallest) * 1.0).item() > 0.0


def test_a_restored_learner_goes_on_in_the_same_bits():
    whole, first, rest = filled(seed=1), filled(seed=1), filled(seed=2)
    observation = np.random.default_rng(0).random((4, 3, 6), np.float32)

    def train(learner):
        for _ in range(50):
            learner.act(observation, 0.5)
            learner.update(1e-3)

    train(whole)
    train(first)
    held = first.state(), json.loads(json.dumps(first.counters()))
    train(first)  # what it does further must not show in the state it has handed out
    rest.restore(*held)
    assert rest.updates == 50
    assert (rest.loss() == whole.loss()).all()
    train(whole)
    train(rest)
    for name, tensor in whole.state().items():
        assert torch.equal(tensor, rest.state()[name]), name
    assert whole.counters() == rest.counters()
    assert (whole.act(observation, 0.5) == rest.act(observation, 0.5)).all()


def test_a_state_that_does_not_fit_is_refused():
    learner = filled()
    state, counters = learner.state(), learner.counters()
    other = filled(NetworkShape(robots=3, inputs=6, hidden=(16, 16, 8), outputs=5))
    with pytest.raises(InputError, match=r"layer2.weight has the shape \(3, 16, 16\)"):
        other.restore(state, counters)
    with pytest.raises(InputError, match="no step"):
        learner.restore({}, counters)
    for wrong in ({}, counters | {"draw": {}}, counters | {"explore": 3}):
        with pytest.raises(InputError, match="counters"):
            learner.restore(state, wrong)


def test_loaded_parameters_reach_the_target_network():
    learner, policy = filled(seed=1), filled(NetworkShape(2, 6, (16, 16, 16), 5), seed=2)
    learner.load_parameters(policy.parameters.to_numpy(), first_robot=1)
    assert torch.equal(learner.target.flat, learner.parameters.flat)
    assert torch.equal(learner.parameters.weights[0][1:], policy.parameters.weights[0])
    assert torch.equal(learner.parameters.weights[0][:1], filled(seed=1).parameters.weights[0][:1])


@pytest.mark.parametrize("device", ["tpu", "cuda:97", "cuda:x", "meta"])
def test_a_device_that_is_not_there_is_refused(device):
    with pytest.raises(InputError, match=f'device is "{device}", but must be "cpu"'):
        StackedDoubleDQN(SHAPE, SETTINGS, np.random.SeedSequence(0), device=device)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_a_gpu_learns_what_the_processor_learns():
    learners = [filled(seed=3), filled(seed=3, device="cuda")]
    observation = np.random.default_rng(0).random((4, 3, 6), np.float32)
    for _ in range(10):
        for learner in learners:
            learner.update(1e-3)
    cpu, gpu = learners
    assert (cpu.act(observation, 0.0) == gpu.act(observation, 0.0)).all()
    assert cpu.counters() == gpu.counters()
    np.testing.assert_allclose(cpu.loss(), gpu.loss(), rtol=1e-3)
    for name, tensor in cpu.state().items():
        torch.testing.assert_close(tensor, gpu.state()[name], rtol=1e-3, atol=1e-4)
