import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from robosim.control.network import Networks, NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.ia2c import Ia2cConfig
from robosim.learning.algorithms.protocol import Experience, State, Task
from tests.learning.walking import deliveries, learned, loop_in

SMALL = Ia2cConfig(hidden=(16, 8), rollout=4)
BLOCKABLE = tuple(f"gain {goal} {side}" for goal in ("home", "source") for side in "NSWE")


def task(robots=2, names=tuple(f"number {i}" for i in range(7))):
    return Task(robots, num_envs=3, names=names, num_actions=5, actions="cardinal", decisions=100)


def build(config=SMALL, seed=0, **changes):
    return config.build(task(**changes), np.random.SeedSequence(seed))


def rollout(seed, decisions=4, envs=3, robots=2, size=7):
    rng = np.random.default_rng(seed)
    shape = (decisions, envs, robots)
    ends = rng.choice(3, size=(decisions, envs), p=[0.6, 0.2, 0.2])
    seen = rng.random((3, *shape, size), np.float32)
    reward = rng.normal(size=shape).astype(np.float32)
    return Experience(seen[0], rng.integers(5, size=shape), reward, seen[1], seen[2], ends == 1, ends == 2)


def take_in(algorithm, done):
    for decision in zip(*done, strict=True):
        algorithm.observe(Experience(*decision))


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


@given(seed=st.integers(0, 1000), discount=st.floats(0.0, 0.99), trace=st.floats(0.0, 1.0))
def test_advantages_are_those_of_a_plain_loop_over_each_episode(seed, discount, trace):
    """Environments end at different times; behind the end of a task nothing counts, behind a cut it does."""
    done = rollout(seed)
    values, following = np.random.default_rng(seed).normal(size=(2, 4, 3, 2)).astype(np.float32)
    algorithm = build(SMALL.changed(discount=discount, gae_lambda=trace, reward_scale=0.5))
    ours = algorithm._advantages(done, values, following)
    for env, robot, first in np.ndindex(3, 2, 4):
        total = 0.0
        for k, t in enumerate(range(first, 4)):
            behind = 0.0 if done.terminated[t, env] else discount * float(following[t, env, robot])
            surprise = 0.5 * float(done.reward[t, env, robot]) + behind - float(values[t, env, robot])
            total += (discount * trace) ** k * surprise
            if done.ended[t, env]:
                break
        assert ours[first, env, robot] == pytest.approx(total, rel=1e-4, abs=1e-4)


def test_robots_do_not_learn_from_each_other():
    """What one robot is paid, however much, leaves the networks of the other as they are."""
    teams = []
    for factor in (1.0, 1000.0):
        algorithm, done = build(), rollout(3)
        take_in(algorithm, done._replace(reward=done.reward * np.float32([1.0, factor])))
        assert algorithm.update(0.5)
        critic = {f"critic{i}": one.detach().numpy() for i, one in enumerate(algorithm.critic)}
        teams.append(algorithm.actors().weights | critic)
    for name, array in teams[0].items():
        np.testing.assert_array_equal(array[0], teams[1][name][0])
    assert any(not np.array_equal(array[1], teams[1][name][1]) for name, array in teams[0].items())


def test_the_gradient_of_each_robot_is_shortened_by_itself():
    algorithm = build(SMALL.changed(gradient_norm=1e-3))
    take_in(algorithm, rollout(4))
    assert algorithm.update(0.0)["gradient_norm"] > 1e-3
    squares = sum(one.grad.square().sum(dim=(1, 2)) for one in algorithm._parameters)
    np.testing.assert_allclose(squares.sqrt().numpy(), 1e-3, rtol=1e-2)


def test_the_decision_under_way_at_an_update_is_left_out(corridor):
    loop, held = loop_in(corridor(num_envs=2), SMALL, 40), []
    for _ in range(11):
        loop.advance()
        held.append(len(loop.algorithm._rollout))
    assert held == [1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1]


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
@pytest.mark.parametrize("decisions", [3, 4, 5, 14])
def test_a_restored_one_goes_on_in_the_same_bits(corridor, parameters, decisions):
    config = SMALL.changed(parameters=parameters)
    whole, rest = (loop_in(corridor(num_envs=3), config, 200, seed).algorithm for seed in (0, 7))
    seen = rollout(1, decisions=decisions + 9)

    def take(algorithms, step):
        acted = [one.act(seen.observation[step], 0.5) for one in algorithms]
        for one in algorithms:
            np.testing.assert_array_equal(acted[0], acted[-1])
            one.update(0.5)
            one.observe(Experience(*(part[step] for part in seen))._replace(action=acted[0]))

    for step in range(decisions):
        take([whole], step)
    tensors, facts = whole.state()
    rest.restore(State(tensors, json.loads(json.dumps(facts))))
    before = whole.actors().weights
    for step in range(decisions, decisions + 9):
        take([whole, rest], step)
    after, again = whole.actors().weights, rest.actors().weights
    for name, array in after.items():
        np.testing.assert_array_equal(array, again[name])
        assert not np.array_equal(array, before[name])


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


def test_it_starts_from_actors_of_its_own_kind():
    first = build().actors()
    # Arrays go by their names: files keep them in another order.
    start = first._replace(weights=dict(sorted(first.weights.items())))
    second = SMALL.starting_from(first.spec).build(task(), np.random.SeedSequence(1), start)
    for name, array in second.actors().weights.items():
        np.testing.assert_array_equal(array, first.weights[name])
    with pytest.raises(InputError, match="has networks of .*but must have ones of"):
        SMALL.starting_from(NetworkSpec(inputs=7, hidden=(16, 8), of_robot=(0,)))
    with pytest.raises(InputError, match="but must have one for all"):
        SMALL.changed(parameters="shared").starting_from(first.spec)
