import copy

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.control.network import Networks, NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.pqn import PqnConfig, lambda_targets
from tests.learning.algorithms.resuming import check_that_a_restored_one_goes_on_in_the_same_bits
from tests.learning.rollouts import BLOCKABLE, build, rollout, take_in, task
from tests.learning.walking import deliveries, learned

SMALL = PqnConfig(hidden=(16, 8), rollout=4, epochs=2, minibatches=2, epsilon_spread=0.0)


class Rms(torch.nn.Module):
    def forward(self, rows):
        return rows / (rows.square().mean(dim=-1, keepdim=True) + 1e-5).sqrt()


def plain_networks(algorithm):
    """The same networks as torch's own modules, one a robot; a shared one is the same module for all."""
    config, modules = algorithm.config, []
    named = algorithm.actors().weights
    for network in range(len(named["layer0.weight"])):
        layers = []
        for number, width in enumerate((*config.hidden, 5)):
            weight, bias = named[f"layer{number}.weight"][network], named[f"layer{number}.bias"][network]
            linear = torch.nn.Linear(*weight.shape)
            with torch.no_grad():
                linear.weight.copy_(torch.from_numpy(weight.T))
                linear.bias.copy_(torch.from_numpy(bias))
            layers.append(linear)
            if number < len(config.hidden):
                if config.normalisation == "layer":
                    layers.append(torch.nn.LayerNorm(width, elementwise_affine=False))
                layers.append(torch.nn.ReLU())
                if config.normalisation == "rms":
                    layers.append(Rms())
        modules.append(torch.nn.Sequential(*layers))
    return modules if len(modules) > 1 else modules * algorithm.task.robots


SUM = {"mixer": "sum", "rollout": 16, "minibatches": 4, "learning_rate": 3e-3}


@pytest.mark.parametrize(("envs", "options"), [(16, {}), (16, {"parameters": "shared"}), (8, SUM)])
def test_it_learns_to_walk_a_corridor_to_and_fro(corridor, envs, options):
    base = PqnConfig(
        hidden=(32, 32),
        discount=0.9,
        exploration=0.5,
        reward_scale=1.0,
        learning_rate=1e-2,
        rollout=8,
        minibatches=1,
    )
    loop = learned(corridor(robots=2, num_envs=envs), base.changed(**options), 10_000)
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert deliveries(corridor, loop.algorithm, 2).min() >= 9
    assert set(loop.log.rows[-1].figures) == {"epsilon", "learning_rate", "loss", "gradient_norm"}


@given(seed=st.integers(0, 1000), discount=st.floats(0.0, 0.99), trace=st.floats(0.0, 1.0))
def test_targets_are_those_of_a_plain_loop_over_each_episode(seed, discount, trace):
    """As they are defined: weighted returns over one decision, two, three, up to the end of what is known."""
    done = rollout(seed, decisions=5)
    following = np.random.default_rng(seed).normal(size=(5, 3, 2)).astype(np.float32)
    ours = lambda_targets(done.reward, following, done.terminated, done.ended, discount, trace)
    for env, robot, first in np.ndindex(3, 2, 5):
        total, paid, left = 0.0, 0.0, 1.0
        for steps, t in enumerate(range(first, 5), start=1):
            paid += discount ** (steps - 1) * float(done.reward[t, env, robot])
            goes_on = 0.0 if done.terminated[t, env] else discount**steps
            over = bool(done.ended[t, env]) or t == 4
            weight = left if over else left * (1 - trace)
            total += weight * (paid + goes_on * float(following[t, env, robot]))
            left -= weight
            if over:
                break
        assert ours[first, env, robot] == pytest.approx(total, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("normalisation", ["none", "rms", "layer"])
@pytest.mark.parametrize("mixer", ["none", "sum"])
@pytest.mark.parametrize("parameters", ["own", "shared"])
def test_an_update_is_that_of_a_plain_network_for_each_robot(parameters, mixer, normalisation):
    config = SMALL.changed(
        parameters=parameters, mixer=mixer, normalisation=normalisation, epochs=3, minibatches=1
    )
    algorithm, done = build(config), rollout(2)
    modules = plain_networks(algorithm)
    seen, final, reward = (
        torch.from_numpy(array) for array in (done.observation, done.final_observation, done.reward)
    )
    with torch.no_grad():
        following = torch.stack([modules[i](final[:, :, i]).amax(dim=-1) for i in (0, 1)], dim=-1)
    if mixer == "sum":
        reward, following = reward.mean(dim=-1, keepdim=True), following.sum(dim=-1, keepdim=True)
    target = torch.from_numpy(
        lambda_targets(
            0.1 * reward.numpy(),
            following.numpy(),
            done.terminated,
            done.ended,
            config.discount,
            config.q_lambda,
        )
    )
    each = list({id(one): one for one in modules}.values())
    optimisers = [torch.optim.RAdam(one.parameters(), lr=config.learning_rate) for one in each]
    for _ in range(config.epochs):
        chosen = torch.stack(
            [
                modules[i](seen[:, :, i]).gather(-1, torch.from_numpy(done.action[:, :, i, None]))[..., 0]
                for i in (0, 1)
            ],
            dim=-1,
        )
        if mixer == "sum":
            chosen = chosen.sum(dim=-1, keepdim=True)
        squares = 0.5 * (chosen - target).square()
        (squares.mean() if parameters == "shared" else squares.mean(dim=(0, 1)).sum()).backward()
        for one, optimiser in zip(each, optimisers, strict=True):
            torch.nn.utils.clip_grad_norm_(one.parameters(), config.gradient_norm)
            optimiser.step()
            optimiser.zero_grad()
    take_in(algorithm, done)
    assert algorithm.update(0.0)
    weights = algorithm.actors().weights
    for network, one in enumerate(each):
        linear = [module for module in one if isinstance(module, torch.nn.Linear)]
        for number, module in enumerate(linear):
            ours = weights[f"layer{number}.weight"][network]
            np.testing.assert_allclose(ours, module.weight.detach().numpy().T, rtol=1e-4, atol=1e-6)
            ours = weights[f"layer{number}.bias"][network]
            np.testing.assert_allclose(ours, module.bias.detach().numpy(), rtol=1e-4, atol=1e-6)


def test_robots_do_not_learn_from_each_other_without_a_mixer():
    """What one robot is paid, however much, leaves the network of the other as it is."""
    teams = []
    for factor in (1.0, 1000.0):
        algorithm, done = build(SMALL), rollout(3)
        take_in(algorithm, done._replace(reward=done.reward * np.float32([1.0, factor])))
        algorithm.update(0.5)
        teams.append(algorithm.actors().weights)
    for name, array in teams[0].items():
        np.testing.assert_array_equal(array[0], teams[1][name][0])
    assert any(not np.array_equal(array[1], teams[1][name][1]) for name, array in teams[0].items())


def test_blocked_moves_are_neither_chosen_nor_expected_to_follow():
    algorithm = build(SMALL.changed(mask=True, epsilon_end=0.0), robots=1, names=BLOCKABLE)
    observation = np.random.default_rng(0).uniform(-0.9, 1.0, (2000, 1, 8)).astype(np.float32)
    observation[..., [0, 4, 1, 5]] = -1.0  # north and south
    values = algorithm.networks.values(observation)
    assert (values.argmax(axis=-1) < 2).any()
    assert algorithm.act(observation, 1.0).min() >= 2
    np.testing.assert_array_equal(algorithm._best(observation), values[..., 2:].max(axis=-1))
    assert algorithm.actors().spec.mask
    # Where observations hold no gains, there is nothing to mask by.
    assert not build(SMALL.changed(mask=True)).actors().spec.mask


@pytest.mark.parametrize("options", [{}, {"parameters": "shared", "mixer": "sum"}])
@pytest.mark.parametrize("decisions", [0, 3, 4, 14])
def test_a_restored_one_goes_on_in_the_same_bits(options, decisions):
    whole, rest = (build(SMALL.changed(**options), seed) for seed in (0, 7))
    check_that_a_restored_one_goes_on_in_the_same_bits(whole, rest, decisions)


@settings(max_examples=12, deadline=None)
@given(
    parameters=st.sampled_from(["own", "shared"]),
    normalisation=st.sampled_from(["none", "rms", "layer"]),
    robots=st.integers(1, 4),
)
def test_the_policy_is_what_the_networks_compute(parameters, normalisation, robots):
    config = SMALL.changed(parameters=parameters, normalisation=normalisation)
    algorithm = build(config, robots=robots)
    spec, weights = algorithm.actors()
    assert spec.of_robot == (tuple(range(robots)) if parameters == "own" else (0,) * robots)
    observation = np.random.default_rng(0).random((50, robots, 7), np.float32)
    outputs = Networks(spec, weights).outputs(observation)
    np.testing.assert_allclose(outputs, algorithm.networks.values(observation), rtol=1e-4, atol=1e-5)


def test_it_starts_from_networks_of_its_own_kind():
    first = build(SMALL).actors()
    start = first._replace(weights=dict(sorted(first.weights.items())))
    config = SMALL.changed(normalisation="none").starting_from(first.spec)
    assert config.normalisation == "layer"
    second = config.build(task(), np.random.SeedSequence(1), start)
    for name, array in second.actors().weights.items():
        np.testing.assert_array_equal(array, first.weights[name])
    with pytest.raises(InputError) as caught:
        SMALL.starting_from(NetworkSpec(inputs=7, hidden=(16, 8), output="logits", of_robot=(0,)))
    assert str(caught.value) == (
        "has networks from own observations to logits by relu, but must have ones from own observations to "
        'action values by relu for the algorithm "pqn".'
    )
    with pytest.raises(InputError, match="but must have one for all"):
        SMALL.changed(parameters="shared").starting_from(first.spec)


def test_what_is_exported_does_not_change_with_the_networks():
    algorithm, done = build(SMALL), rollout(4)
    before = algorithm.actors().weights
    kept = copy.deepcopy(before)
    take_in(algorithm, done)
    algorithm.update(0.0)
    for name, array in kept.items():
        np.testing.assert_array_equal(before[name], array)
        assert not np.array_equal(algorithm.actors().weights[name], array)
