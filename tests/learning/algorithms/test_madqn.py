import numpy as np
import pytest

from robosim.control.network import Networks
from robosim.errors import InputError
from robosim.learning.algorithms.madqn import MadqnConfig
from robosim.learning.algorithms.protocol import LargeMemory
from tests.learning.algorithms.resuming import check_that_a_restored_one_goes_on_in_the_same_bits
from tests.learning.rollouts import build, rollout, take_in
from tests.learning.walking import deliveries, learned

SMALL = MadqnConfig(hidden=(16, 8), warmup=4, batch_size=4, return_steps=2, replay_capacity=50)


def test_a_team_of_two_learns_to_walk_a_corridor_to_and_fro(corridor):
    config = MadqnConfig(
        hidden=(64, 64),
        warmup=200,
        discount=0.9,
        exploration=0.8,
        epsilon_spread=1.0,
        reward_scale=1.0,
        target_interval=50,
    )
    loop = learned(corridor(robots=2, num_envs=4), config, 6000)
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert deliveries(corridor, loop.algorithm, 2).min() >= 9


def test_it_remembers_the_whole_team_s_decision_and_its_mean_reward():
    algorithm, done = build(SMALL.changed(return_steps=1), robots=3), rollout(0, robots=3)
    take_in(algorithm, done)
    kept = algorithm.export(*algorithm.held())
    np.testing.assert_array_equal(kept["observations"][0], done.observation.reshape(12, 21))
    np.testing.assert_array_equal(kept["successors"][0], done.final_observation.reshape(12, 21))
    np.testing.assert_allclose(kept["rewards"][0], done.reward.mean(axis=2).ravel(), rtol=1e-6)
    assert kept["actions"][0].tolist() == [
        (first * 5 + second) * 5 + third for first, second, third in done.action.reshape(12, 3)
    ]


def test_it_acts_by_its_policy_once_it_does_not_explore():
    algorithm = build(SMALL.changed(epsilon_end=0.0), robots=3)
    spec, weights = algorithm.actors()
    assert (spec.input, spec.output, spec.outputs) == ("team", "joint action values", 125)
    observation = np.random.default_rng(0).random((200, 3, 7), np.float32)
    actions = algorithm.act(observation, 1.0)
    np.testing.assert_array_equal(actions, Networks(spec, weights).act(observation))
    assert len(np.unique(actions, axis=0)) > 3


def test_exploring_teams_draw_every_combination_alike():
    algorithm = build(SMALL, robots=2)
    drawn = algorithm.act(np.zeros((25_000, 2, 7), np.float32), 0.0)
    counts = np.bincount(drawn[:, 0] * 5 + drawn[:, 1], minlength=25)
    # Six standard deviations of a count with mean 1000.
    assert abs(counts - 1000).max() < 190


@pytest.mark.parametrize("decisions", [0, 3, 14])
def test_a_restored_one_goes_on_in_the_same_bits(decisions):
    whole, rest = (build(SMALL, seed) for seed in (0, 7))
    assert isinstance(whole, LargeMemory)
    check_that_a_restored_one_goes_on_in_the_same_bits(whole, rest, decisions)


def test_teams_of_nine_are_refused_in_a_sentence():
    with pytest.raises(InputError) as caught:
        build(SMALL, robots=9)
    assert str(caught.value) == (
        'robots is 9, but must be at most 8 for the algorithm "madqn": its network has an output for each of '
        "the 5 ** 9 combinations of the robots' actions."
    )


def test_it_starts_from_a_network_of_its_own_kind():
    first = build(SMALL).actors()
    second = build(SMALL.starting_from(first.spec), 1, first)
    for name, array in second.actors().weights.items():
        np.testing.assert_array_equal(array, first.weights[name])
    with pytest.raises(InputError) as caught:
        SMALL.changed(hidden=(9,)).starting_from(first.spec)
    assert str(caught.value) == (
        'has a network of ["team", "relu", "none", "joint action values", [16, 8], false], but must have one '
        'of ["team", "relu", "none", "joint action values", [9], false] for the algorithm "madqn" (input, '
        "activation, normalisation, output, hidden, mask)."
    )
