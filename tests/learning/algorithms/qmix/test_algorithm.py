import copy

import numpy as np
import pytest
import torch

from robosim.control.network import Networks
from robosim.errors import InputError
from robosim.learning.algorithms.protocol import Experience, LargeMemory, Task
from robosim.learning.algorithms.qmix.config import QmixConfig
from tests.learning.algorithms.resuming import check_that_a_restored_one_goes_on_in_the_same_bits
from tests.learning.rollouts import BLOCKABLE, build, one_by_one, rollout
from tests.learning.walking import deliveries, learned

SMALL = QmixConfig(
    hidden=(16, 8),
    mixer_width=4,
    hyper_width=6,
    warmup=4,
    batch_size=6,
    return_steps=2,
    replay_capacity=50,
    target_interval=3,
)


@pytest.mark.parametrize("mixer", ["sum", "monotonic"])
def test_it_learns_to_walk_a_corridor_to_and_fro(corridor, mixer):
    config = QmixConfig(
        mixer=mixer,
        hidden=(32, 32),
        learning_rate=2e-3,
        warmup=200,
        discount=0.9,
        exploration=0.5,
        epsilon_spread=1.0,
        reward_scale=1.0,
        updates_per_step=0.2,
        target_interval=50,
    )
    loop = learned(corridor(robots=2, num_envs=4), config, 4000)
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert deliveries(corridor, loop.algorithm, 2).min() >= 9


def plain_value(networks, robot, observation, action):
    """The value of one robot's action, layer by layer."""
    weights = [one.detach() for one in networks.parameters]
    network = 0 if len(weights[0]) == 1 else robot
    hidden = observation
    for layer in range(0, len(weights), 2):
        hidden = hidden @ weights[layer][network] + weights[layer + 1][network, 0]
        if layer < len(weights) - 2:
            hidden = torch.relu(hidden)
    return hidden if action is None else hidden[action]


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("mixer", ["sum", "monotonic"])
@pytest.mark.parametrize("parameters", ["own", "shared"])
def test_the_loss_is_that_of_one_robot_and_one_moment_after_another(parameters, mixer, mask):
    config = SMALL.changed(parameters=parameters, mixer=mixer, mask=mask)
    algorithm, done = build(config, names=BLOCKABLE), rollout(5, decisions=6, size=8)
    final = done.final_observation
    final[np.random.default_rng(0).random(final.shape) < 0.6] = -1.0
    for decision in one_by_one(done):
        algorithm.observe(decision)
        algorithm.update(0.0)  # so that the target networks are not the networks
    assert algorithm.updates > 3
    batch = algorithm._batch
    algorithm.replay.sample(np.random.default_rng(1), batch, together=True)
    squares = []
    for row in range(config.batch_size):
        now, after = batch.observations[:, row], batch.successors[:, row]
        chosen, following = [], []
        for robot in range(2):
            action = int(batch.actions[robot, row])
            chosen.append(plain_value(algorithm.networks, robot, now[robot], action))
            values = plain_value(algorithm.networks, robot, after[robot], None)
            open_moves = [
                move
                for move in range(5)
                if not (mask and move < 4 and after[robot, move] == after[robot, 4 + move] == -1)
            ]
            best = max(open_moves, key=lambda move, values=values: float(values[move]))
            following.append(plain_value(algorithm.target_networks, robot, after[robot], best))
        with torch.no_grad():
            team = algorithm.mixer(torch.stack(chosen)[:, None], now.reshape(1, -1))[0]
            then = algorithm.target_mixer(torch.stack(following)[:, None], after.reshape(1, -1))[0]
        reward = 0.1 * batch.rewards[:, row].mean()
        goes_on = batch.continues[0, row, 0]
        assert (batch.continues[:, row] == goes_on).all()
        squares.append(float(team - reward - config.discount**2 * goes_on * then) ** 2)
    assert float(algorithm.loss(batch).detach()) == pytest.approx(np.mean(squares), rel=1e-4)
    assert {0.0, 1.0} == set(algorithm.export(*algorithm.held())["continues"].unique().tolist())


def test_target_networks_stay_until_they_are_copied():
    algorithm, done = build(SMALL.changed(updates_per_step=0.25)), one_by_one(rollout(0, decisions=20))
    kept = copy.deepcopy(algorithm._targets)
    for decision in done:
        before = algorithm.updates
        algorithm.update(0.0)
        algorithm.observe(decision)
        if before // 3 < algorithm.updates // 3:
            break
        for one, target in zip(kept, algorithm._targets, strict=True):
            assert torch.equal(one, target)
    assert algorithm.updates % 3 == 0
    for one, target in zip(algorithm._learning, algorithm._targets, strict=True):
        assert torch.equal(one, target)
    assert not torch.equal(kept[0], algorithm._targets[0])


PAYOFF = np.array([[0.0, 1.0], [1.0, 8.0]])
"""Of two robots that choose between two actions: the game 2B of the QMIX paper."""


@pytest.mark.parametrize(
    ("mixer", "learned_values"),
    [("monotonic", PAYOFF), ("sum", np.array([[-1.5, 2.5], [2.5, 6.5]]))],
)
def test_qmix_represents_a_game_of_which_vdn_learns_the_additive_part(mixer, learned_values):
    """The best sum of two values in the sense of least squares is row mean + column mean - mean."""
    config = QmixConfig(
        mixer=mixer,
        hidden=(16,),
        learning_rate=1e-2,
        batch_size=32,
        return_steps=1,
        reward_scale=1.0,
        warmup=0,
        parameters="own",
    )
    algorithm = build(config, names=("nothing",), num_actions=2)
    joint = np.stack(np.meshgrid([0, 1], [0, 1], indexing="ij"), axis=-1).reshape(4, 2)
    paid = np.repeat(PAYOFF.ravel()[:, None], 2, axis=1).astype(np.float32)
    seen, over = np.ones((4, 2, 1), np.float32), np.ones(4, bool)
    algorithm.observe(Experience(seen, joint, paid, seen, seen, over, ~over))
    for step in range(600):
        algorithm._optimiser.param_groups[0]["lr"] = 1e-2 * (1 - step / 600)
        algorithm._step()
    values = torch.from_numpy(algorithm.networks.values(seen[:1])[0])
    chosen = values.gather(1, torch.from_numpy(joint.T))
    with torch.no_grad():
        team = algorithm.mixer(chosen, torch.ones(4, 2)).reshape(2, 2)
    np.testing.assert_allclose(team, learned_values, atol=0.3)


@pytest.mark.parametrize("options", [{}, {"mixer": "sum", "parameters": "own"}])
@pytest.mark.parametrize("decisions", [0, 3, 14, 25])
def test_a_restored_one_goes_on_in_the_same_bits(options, decisions):
    whole, rest = (build(SMALL.changed(**options), seed) for seed in (0, 7))
    assert isinstance(whole, LargeMemory)
    check_that_a_restored_one_goes_on_in_the_same_bits(whole, rest, decisions)


@pytest.mark.parametrize("parameters", ["own", "shared"])
def test_the_policy_is_what_the_networks_compute(parameters):
    algorithm = build(SMALL.changed(parameters=parameters, normalisation="layer", epsilon_end=0.0))
    spec, weights = algorithm.actors()
    assert spec.shared is (parameters == "shared")
    observation = np.random.default_rng(0).random((50, 2, 7), np.float32)
    actions = algorithm.act(observation, 1.0)
    np.testing.assert_array_equal(Networks(spec, weights).act(observation), actions)
    start = SMALL.changed(parameters=parameters).starting_from(spec)
    assert start.normalisation == "layer"
    again = start.build(algorithm.task, np.random.SeedSequence(5), algorithm.actors())
    for name, array in again.actors().weights.items():
        np.testing.assert_array_equal(array, weights[name])


def test_a_replay_beyond_the_memory_is_refused_in_a_sentence():
    with pytest.raises(InputError) as caught:
        QmixConfig(replay_capacity=10**8, mixer="sum").build(
            Task(1000, 3, ("a",) * 1000, 5, "cardinal", 10**12), np.random.SeedSequence(0)
        )
    assert str(caught.value) == (
        "replay_capacity is 100000000, but must be less: 1000 robots with observations of 1000 numbers need "
        "more memory than there is."
    )
