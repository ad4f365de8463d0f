import numpy as np
import pytest
import torch

from robosim.control.network import Networks
from robosim.learning.algorithms.ia2c import Ia2cConfig
from tests.learning.rollouts import BLOCKABLE, build, rollout, take_in, weights_of
from tests.learning.walking import deliveries, learned

SMALL = Ia2cConfig(hidden=(16, 8), rollout=4)


@pytest.mark.parametrize("parameters", ["own", "shared"])
def test_it_learns_to_walk_a_corridor_to_and_fro(corridor, parameters):
    config = Ia2cConfig(
        parameters=parameters, hidden=(32, 32), learning_rate=1e-2, reward_scale=1.0, entropy_weight=0.03
    )
    loop = learned(corridor(robots=2, num_envs=8), config, 12_000)
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert deliveries(corridor, loop.algorithm, 2).min() >= 9
    figures = loop.log.rows[-1].figures
    assert set(figures) == {"policy_loss", "value_loss", "entropy", "gradient_norm", "learning_rate"}
    assert figures["entropy"] < 0.5 * np.log(5)


def test_robots_do_not_learn_from_each_other():
    """What one robot is paid, however much, leaves the networks of the other as they are."""
    teams = []
    for factor in (1.0, 1000.0):
        algorithm, done = build(SMALL), rollout(3)
        take_in(algorithm, done._replace(reward=done.reward * np.float32([1.0, factor])))
        assert algorithm.update(0.5)
        teams.append(weights_of(algorithm))
    for name, array in teams[0].items():
        np.testing.assert_array_equal(array[0], teams[1][name][0])
    assert any(not np.array_equal(array[1], teams[1][name][1]) for name, array in teams[0].items())


def test_the_gradient_of_each_robot_is_shortened_by_itself():
    algorithm = build(SMALL.changed(gradient_norm=1e-3))
    take_in(algorithm, rollout(4))
    assert algorithm.update(0.0)["gradient_norm"] > 1e-3
    squares = sum(one.grad.square().sum(dim=(1, 2)) for one in algorithm._parameters)
    np.testing.assert_allclose(squares.sqrt().numpy(), 1e-3, rtol=1e-2)


def test_blocked_moves_are_never_drawn_and_have_no_entropy():
    algorithm = build(SMALL.changed(mask=True), robots=1, names=BLOCKABLE)
    observation = np.zeros((2000, 1, 8), np.float32)
    observation[..., [0, 4, 1, 5]] = -1.0  # north and south
    counts = np.bincount(algorithm.act(observation, 0.0).ravel(), minlength=5)
    assert counts[:2].tolist() == [0, 0]
    assert counts[2:].min() > 500
    done = rollout(0, robots=1, size=8)
    done = done._replace(observation=np.tile(observation[:3], (4, 1, 1, 1)), action=np.full((4, 3, 1), 4))
    assert algorithm._losses(done).entropy.item() == pytest.approx(np.log(3), abs=1e-3)
    assert algorithm.actors().spec.mask
    # Where observations hold no gains, there is nothing to mask by.
    assert not build(SMALL.changed(mask=True)).actors().spec.mask


@pytest.mark.parametrize("parameters", ["own", "shared"])
def test_the_policy_is_what_the_actors_compute(parameters):
    algorithm = build(SMALL.changed(parameters=parameters))
    spec, weights = algorithm.actors()
    assert (spec.output, spec.activation) == ("logits", "tanh")
    assert spec.of_robot == ((0, 1) if parameters == "own" else (0, 0))
    observation = np.random.default_rng(0).random((50, 2, 7), np.float32)
    with torch.no_grad():
        logits = algorithm._logits(torch.from_numpy(observation)).numpy()
    np.testing.assert_allclose(Networks(spec, weights).outputs(observation), logits, rtol=1e-4, atol=1e-6)
