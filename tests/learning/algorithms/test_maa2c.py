from itertools import product

import numpy as np
import pytest
import torch

from robosim.control.network import Networks
from robosim.errors import InputError
from robosim.learning.algorithms.maa2c import MaA2cConfig
from robosim.learning.algorithms.protocol import Experience
from robosim.learning.config import run_config
from tests.learning.rollouts import BLOCKABLE, build, rollout, take_in

SMALL = MaA2cConfig(hidden=(16, 8), rollout=4)


def test_it_learns_what_takes_the_observations_of_both_robots():
    """Each robot has to do what only the other one sees: with its own observation alone, it can but guess."""
    config = MaA2cConfig(hidden=(32,), rollout=4, learning_rate=1e-2, entropy_weight=0.02, reward_scale=1.0)
    algorithm, rng = build(config), np.random.default_rng(0)

    def asked(envs):
        observation = rng.integers(2, size=(envs, 2, 7)).astype(np.float32)
        return observation, observation[:, ::-1, 0].astype(np.int64)

    always, never = np.ones(32, bool), np.zeros(32, bool)
    for _ in range(800):
        observation, right = asked(32)
        action = algorithm.act(observation, 0.0)
        algorithm.update(0.0)
        paid = np.repeat((action == right).all(axis=1, keepdims=True), 2, axis=1).astype(np.float32)
        algorithm.observe(Experience(observation, action, paid, observation, observation, always, never))
    observation, right = asked(200)
    networks = Networks(*algorithm.actors())
    assert (networks.act(observation) == right).all()


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_combinations_are_chosen_kept_and_played_by_the_same_digits(robots):
    algorithm = build(SMALL, robots=robots)
    observation = rollout(0, robots=robots).observation[0]
    for number, digits in enumerate(product(range(5), repeat=robots)):
        with torch.no_grad():
            algorithm.actor.parameters[-1].zero_()
            algorithm.actor.parameters[-1][..., number] = 1e3
        acted = algorithm.act(observation, 0.0)
        assert acted.tolist() == Networks(*algorithm.actors()).act(observation).tolist() == [list(digits)] * 3
        done = rollout(1, decisions=1, robots=robots)
        take_in(algorithm, done._replace(action=acted[None]))
        assert algorithm._rollout[-1].action.tolist() == [[number]] * 3


def test_it_learns_from_the_mean_reward_of_the_team():
    algorithm, done = build(SMALL), rollout(2)
    take_in(algorithm, done)
    for held, reward in zip(algorithm._rollout, done.reward, strict=True):
        np.testing.assert_allclose(held.reward, reward.mean(axis=1, keepdims=True), rtol=1e-6)


def test_the_policy_is_what_the_actor_computes():
    algorithm = build(SMALL)
    spec, weights = algorithm.actors()
    assert (spec.input, spec.output, spec.networks, spec.joint) == ("team", "joint logits", 1, True)
    observation = np.random.default_rng(0).random((50, 2, 7), np.float32)
    with torch.no_grad():
        logits = algorithm._logits(torch.from_numpy(observation.reshape(50, 1, 14)))[:, 0].numpy()
    np.testing.assert_allclose(Networks(spec, weights).outputs(observation), logits, rtol=1e-4, atol=1e-6)


def test_combinations_with_a_blocked_move_are_never_drawn_and_have_no_entropy():
    algorithm = build(SMALL.changed(mask=True), robots=2, names=BLOCKABLE)
    observation = np.zeros((2000, 2, 8), np.float32)
    observation[:, 0, [0, 4, 1, 5]] = -1.0  # north and south, of the first robot
    acted = algorithm.act(observation, 0.0)
    assert np.bincount(acted[:, 0], minlength=5)[:2].tolist() == [0, 0]
    assert np.bincount(acted[:, 1], minlength=5).min() > 250
    done = rollout(0, size=8)._replace(observation=np.tile(observation[:3], (4, 1, 1, 1)))
    take_in(algorithm, done._replace(action=np.full((4, 3, 2), 4)))
    assert algorithm.update(0.0)["entropy"] == pytest.approx(np.log(15), abs=1e-3)
    assert algorithm.actors().spec.mask


def test_too_many_robots_are_refused_in_a_sentence():
    with pytest.raises(InputError) as caught:
        build(SMALL, robots=9)
    assert str(caught.value) == (
        'robots is 9, but must be at most 8 for the algorithm "maa2c": one actor for all has an output for '
        "each combination of their 5 actions, 1953125 of them."
    )


def test_nobody_can_be_frozen_beside_a_network_for_all():
    with pytest.raises(InputError) as caught:
        run_config("maa2c", curriculum=True)
    assert str(caught.value).startswith("curriculum is true, but must be false where robots share a network")
