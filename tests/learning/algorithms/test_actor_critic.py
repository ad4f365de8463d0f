import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.control.network import NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.actor_critic import advantages, standardised
from robosim.learning.algorithms.ia2c import Ia2cConfig
from robosim.learning.algorithms.maa2c import MaA2cConfig
from robosim.learning.algorithms.ppo import PpoConfig
from tests.learning.algorithms.resuming import check_that_a_restored_one_goes_on_in_the_same_bits
from tests.learning.rollouts import build, rollout
from tests.learning.walking import loop_in

SMALL = {"hidden": (16, 8), "rollout": 4}
KINDS = [
    pytest.param(Ia2cConfig(**SMALL), id="ia2c"),
    pytest.param(Ia2cConfig(**SMALL, parameters="shared"), id="ia2c, shared"),
    pytest.param(PpoConfig(**SMALL), id="ppo"),
    pytest.param(PpoConfig(**SMALL, parameters="shared", critic="team"), id="ppo, shared, team"),
    pytest.param(MaA2cConfig(**SMALL), id="maa2c"),
]


@given(seed=st.integers(0, 1000), discount=st.floats(0.0, 0.99), trace=st.floats(0.0, 1.0))
def test_advantages_are_those_of_a_plain_loop_over_each_episode(seed, discount, trace):
    """Environments end at different times; behind the end of a task nothing counts, behind a cut it does."""
    done = rollout(seed)
    values, following = np.random.default_rng(seed).normal(size=(2, 4, 3, 2)).astype(np.float32)
    config = Ia2cConfig(discount=discount, gae_lambda=trace, reward_scale=0.5)
    ours = advantages(config, done, values, following)
    for env, robot, first in np.ndindex(3, 2, 4):
        total = 0.0
        for k, t in enumerate(range(first, 4)):
            behind = 0.0 if done.terminated[t, env] else discount * float(following[t, env, robot])
            surprise = 0.5 * float(done.reward[t, env, robot]) + behind - float(values[t, env, robot])
            total += (discount * trace) ** k * surprise
            if done.ended[t, env]:
                break
        assert ours[first, env, robot] == pytest.approx(total, rel=1e-4, abs=1e-4)


def test_where_robots_share_a_network_one_that_stands_counts_little():
    """Its advantages are the critic's noise; where it has a network of its own, they are all there is."""
    numbers = np.random.default_rng(0).normal(3.0, 1.0, (16, 8, 2)).astype(np.float32)
    numbers[..., 1] = 3.0 + 1e-3 * (numbers[..., 1] - 3.0)
    of_each, of_all = standardised(numbers, 2), standardised(numbers, 1)
    np.testing.assert_allclose(of_each.std(axis=(0, 1)), [1.0, 1.0], rtol=1e-3)
    np.testing.assert_allclose(of_each.mean(axis=(0, 1)), [0.0, 0.0], atol=1e-3)
    assert of_all.std() == pytest.approx(1.0, rel=1e-3)
    assert of_all[..., 1].std() < 2e-3


@pytest.mark.parametrize("config", KINDS)
def test_the_decision_under_way_at_an_update_is_left_out(corridor, config):
    loop, held = loop_in(corridor(num_envs=2), config, 40), []
    for _ in range(11):
        loop.advance()
        held.append(len(loop.algorithm._rollout))
    assert held == [1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1]


@pytest.mark.parametrize("config", KINDS)
@pytest.mark.parametrize("decisions", [3, 4, 5, 14])
def test_a_restored_one_goes_on_in_the_same_bits(config, decisions):
    check_that_a_restored_one_goes_on_in_the_same_bits(build(config), build(config, 7), decisions)


@pytest.mark.parametrize("config", KINDS)
def test_it_starts_from_actors_of_its_own_kind(config):
    first = build(config).actors()
    # Arrays go by their names: files keep them in another order.
    start = first._replace(weights=dict(sorted(first.weights.items())))
    second = build(config.starting_from(first.spec), 1, start)
    for name, array in second.actors().weights.items():
        np.testing.assert_array_equal(array, first.weights[name])
    with pytest.raises(InputError) as caught:
        config.starting_from(NetworkSpec(inputs=7, hidden=(16, 8), of_robot=(0,)))
    sees, puts_out = config.actor_kind
    assert str(caught.value) == (
        'has networks of ["own", "relu", "none", "action values", [16, 8]], but must have ones of '
        f'["{sees}", "tanh", "none", "{puts_out}", [16, 8]] for the algorithm "{config.name}" '
        "(input, activation, normalisation, output, hidden)."
    )


def test_many_networks_cannot_become_one():
    with pytest.raises(InputError) as caught:
        PpoConfig(**SMALL, parameters="shared").starting_from(build(PpoConfig(**SMALL)).actors().spec)
    assert str(caught.value) == (
        'has a network for each robot, but must have one for all where parameters is "shared".'
    )
