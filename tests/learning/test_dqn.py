import numpy as np
import pytest
import torch

from robosim.learning.dqn import DqnSettings, StackedDoubleDQN
from robosim.learning.networks import NetworkShape

SHAPE = NetworkShape(robots=3, inputs=6, hidden=(16, 16, 16), outputs=5)
SETTINGS = DqnSettings(discount=0.9, batch_size=8, target_interval=3, replay_capacity=50, reward_scale=0.5)


def filled(shape=SHAPE, seed=0, reward_of_last=1.0):
    learner = StackedDoubleDQN(shape, SETTINGS, np.random.SeedSequence(seed))
    rng = np.random.default_rng(7)
    for _ in range(20):
        observation, successor = rng.random((2, 2, shape.robots, shape.inputs), np.float32)
        reward = rng.random((2, shape.robots), np.float32)
        reward[:, -1] *= reward_of_last
        learner.replay.add(observation, rng.integers(5, size=reward.shape), reward, successor)
    return learner


def linear_networks(parameters):
    networks = []
    for robot in range(parameters.shape.robots):
        layers = []
        for weight, bias in zip(parameters.weights, parameters.biases, strict=True):
            linear = torch.nn.Linear(weight.shape[1], weight.shape[2])
            linear.weight.data.copy_(weight[robot].T)
            linear.bias.data.copy_(bias[robot, 0])
            layers += [linear, torch.nn.ReLU()]
        networks.append(torch.nn.Sequential(*layers[:-1]))
    return networks


def test_updates_equal_plain_double_dqn_with_autograd():
    learner = filled()
    online, target = linear_networks(learner.parameters), linear_networks(learner.target)
    optimisers = [torch.optim.Adam(network.parameters(), lr=1e-3) for network in online]
    draws = []
    sample = learner.replay.sample

    def recorded(batch, rng):
        drawn = sample(batch, rng)
        draws.append([part.numpy().copy() for part in drawn])
        return drawn

    learner.replay.sample = recorded
    for update in range(1, 8):
        learner.update(1e-3)
        observations, actions, rewards = map(torch.from_numpy, draws[-1])
        for robot in range(SHAPE.robots):
            now, after = observations[robot, 0::2], observations[robot, 1::2]
            with torch.no_grad():
                best = online[robot](after).argmax(dim=1, keepdim=True)
                goal = 0.5 * rewards[robot] + 0.9 * target[robot](after).gather(1, best)[:, 0]
            loss = (online[robot](now).gather(1, actions[robot])[:, 0] - goal).square().mean()
            assert float(learner.loss()[robot]) == pytest.approx(loss.item(), rel=1e-3)
            optimisers[robot].zero_grad()
            loss.backward()
            optimisers[robot].step()
            if update % 3 == 0:
                target[robot].load_state_dict(online[robot].state_dict())
        expected = linear_networks(learner.parameters)
        for ours, theirs in zip(expected, online, strict=True):
            for one, other in zip(ours.parameters(), theirs.parameters(), strict=True):
                torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


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
