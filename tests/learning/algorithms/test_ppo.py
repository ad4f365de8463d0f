import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from robosim.control.network import Networks
from robosim.errors import InputError
from robosim.learning.algorithms.ppo import PpoConfig, ReturnScale
from robosim.learning.algorithms.pqn import PqnConfig
from tests.learning.rollouts import BLOCKABLE, build, rollout, take_in, task, weights_of
from tests.learning.walking import deliveries, learned

SMALL = PpoConfig(hidden=(16, 8), rollout=4, epochs=2, minibatches=3)
KINDS = [(parameters, critic) for parameters in ("own", "shared") for critic in ("own", "team")]
four_kinds = pytest.mark.parametrize(("parameters", "critic"), KINDS)


@pytest.mark.parametrize(("parameters", "critic"), [("own", "own"), ("shared", "team")])
def test_it_learns_to_walk_a_corridor_to_and_fro(corridor, parameters, critic):
    config = PpoConfig(
        parameters=parameters, critic=critic, hidden=(32, 32), rollout=32, learning_rate=1e-2,
        learning_rate_end=0.02, discount=0.95, entropy_weight=0.03, reward_scale=1.0,
    )  # fmt: skip
    loop = learned(corridor(robots=2, num_envs=8), config, 6_000)
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert deliveries(corridor, loop.algorithm, 2).min() >= 9
    assert set(loop.log.rows[-1].figures) == {
        "policy_loss", "value_loss", "entropy", "clipped", "gradient_norm", "learning_rate",
    }  # fmt: skip


class Plain:
    """PPO of one robot and one decision at a time, in float64."""

    def __init__(self, config, algorithm):
        self.config, self.robots = config, 2
        self.actor, self.critic = (
            [one.detach().double().clone().requires_grad_() for one in layers]
            for layers in (algorithm.actor.parameters, algorithm.critic.parameters)
        )

    def network(self, robot):
        return robot if self.config.parameters == "own" else 0

    def out(self, layers, robot, numbers):
        hidden, network = numbers, self.network(robot)
        for i in range(0, len(layers), 2):
            hidden = hidden @ layers[i][network] + layers[i + 1][network, 0]
            hidden = torch.tanh(hidden) if i < len(layers) - 2 else hidden
        return hidden

    def chances(self, seen, robot):
        """Return the logarithms of the chances of the actions of a robot; `seen` is [robots, size]."""
        return torch.log_softmax(self.out(self.actor, robot, seen[robot]), dim=0)

    def value(self, seen, robot):
        """Return what the critic of a robot puts out."""
        team = torch.cat(list(seen))
        numbers = {
            ("own", "own"): seen[robot],
            ("shared", "own"): seen[robot],
            ("own", "team"): team,
            ("shared", "team"): torch.cat((seen[robot], team)),
        }
        return self.out(self.critic, robot, numbers[self.config.parameters, self.config.critic])[0]

    def advantages(self, done, units):
        """Return advantages and returns, [decisions, envs, robots]; a unit is a mean and a deviation."""
        config, gained = self.config, np.zeros(done.reward.shape)
        expected = np.zeros(done.reward.shape)
        for t, env, robot in reversed(list(np.ndindex(gained.shape))):
            mean, deviation = units[robot]
            seen = torch.from_numpy(done.observation[t, env]).double()
            final = torch.from_numpy(done.final_observation[t, env]).double()
            expected[t, env, robot] = float(self.value(seen, robot).detach()) * deviation + mean
            follows = float(self.value(final, robot).detach()) * deviation + mean
            target = config.reward_scale * float(done.reward[t, env, robot])
            target += 0.0 if done.terminated[t, env] else config.discount * follows
            gained[t, env, robot] = target - expected[t, env, robot]
            if t < len(gained) - 1 and not done.ended[t, env]:
                gained[t, env, robot] += config.discount * config.gae_lambda * gained[t + 1, env, robot]
        return gained, gained + expected

    def losses(self, batch):
        """Return policy loss, value loss and entropy of each network, of a Batch [decisions, robots, ...]."""
        config = self.config
        sums = [[[], [], []] for _ in range(self.robots if config.parameters == "own" else 1)]
        for row, robot in np.ndindex(batch.action.shape):
            seen = batch.observation[row].double()
            chances = self.chances(seen, robot)
            ratio = torch.exp(chances[batch.action[row, robot]] - batch.chance[row, robot])
            gain = batch.advantage[row, robot]
            kept = min(max(ratio, 1 - config.clip), 1 + config.clip)
            value, before = self.value(seen, robot), batch.predicted[row, robot]
            near = before + torch.clamp(value - before, -config.value_clip, config.value_clip)
            errors = [self.huber(one - batch.target[row, robot]) for one in (value, near)]
            policy, error, entropy = sums[self.network(robot)]
            policy.append(-min(ratio * gain, kept * gain))
            error.append(max(errors) if config.value_clip else errors[0])
            entropy.append(-(chances.exp() * chances).sum())
        return [[torch.stack(part).mean() for part in parts] for parts in sums]

    def huber(self, error):
        limit = self.config.huber
        if limit == 0.0 or abs(error) <= limit:
            return 0.5 * error**2
        return limit * (abs(error) - 0.5 * limit)


@four_kinds
@pytest.mark.parametrize(("value_clip", "huber"), [(0.2, 0.3), (0.0, 0.0)])
def test_losses_and_gradients_are_those_of_a_plain_loop(parameters, critic, value_clip, huber):
    config = SMALL.changed(
        parameters=parameters,
        critic=critic,
        value_clip=value_clip,
        huber=huber,
        clip=0.05,
        entropy_weight=0.3,
    )
    algorithm, rng = build(config), np.random.default_rng(5)
    with torch.no_grad():
        for one in algorithm._parameters:
            one.add_(torch.from_numpy(rng.normal(0.0, 0.3, one.shape).astype(np.float32)))
    batch = algorithm._prepared(rollout(2))
    with torch.no_grad():
        # The networks after some steps: ratios are no longer 1.
        for one in algorithm._parameters:
            one.add_(torch.from_numpy(rng.normal(0.0, 0.02, one.shape).astype(np.float32)))
    losses, clipped = algorithm._losses(batch)
    algorithm._descend(losses)
    plain = Plain(config, algorithm)
    theirs = plain.losses(batch)
    np.testing.assert_allclose(
        torch.stack(losses).detach().T,
        [[float(part.detach()) for part in parts] for parts in theirs],
        rtol=1e-4,
        atol=1e-6,
    )
    assert 0.1 < float(clipped) < 0.9
    total = sum(
        policy + config.value_weight * error - config.entropy_weight * entropy
        for policy, error, entropy in theirs
    )
    total.backward()
    for ours, one in zip(algorithm._parameters, (*plain.actor, *plain.critic), strict=True):
        np.testing.assert_allclose(ours.grad, one.grad, rtol=2e-3, atol=2e-6)


@four_kinds
@pytest.mark.parametrize("normalised", [False, True])
def test_what_is_learned_from_a_rollout_is_that_of_a_plain_loop(parameters, critic, normalised):
    config = SMALL.changed(parameters=parameters, critic=critic, value_normalisation=normalised)
    algorithm, rng = build(config), np.random.default_rng(0)
    networks = 2 if parameters == "own" else 1
    with torch.no_grad():
        for one in algorithm._parameters:
            one.add_(torch.from_numpy(rng.normal(0.0, 0.3, one.shape).astype(np.float32)))
    earlier = (rng.normal(size=(4, 3, 2)) * [1.0, 5.0] + [3.0, -2.0]).astype(np.float32)
    algorithm.scale.add(earlier)

    def of_network(numbers):
        """Return the numbers of each network, of [decisions, envs, robots]."""
        return [numbers.ravel()] if networks == 1 else [numbers[..., robot].ravel() for robot in (0, 1)]

    plain, done = Plain(config, algorithm), rollout(2)
    units = [(part.mean(), part.std()) if normalised else (0.0, 1.0) for part in of_network(earlier)]
    gained, returns = plain.advantages(done, [units[plain.network(robot)] for robot in (0, 1)])
    batch = algorithm._prepared(done)
    for robot in (0, 1):
        network = plain.network(robot)
        both = [of_network(earlier)[network], of_network(returns)[network]]
        weights = np.array([0.95, 1.0])  # the rollout before counts a little less
        mean = np.average([part.mean() for part in both], weights=weights)
        square = np.average([np.square(part).mean() for part in both], weights=weights)
        mean, deviation = (mean, np.sqrt(square - mean**2)) if normalised else (0.0, 1.0)
        target = (returns[..., robot].ravel() - mean) / deviation
        np.testing.assert_allclose(batch.target[:, robot], target, rtol=1e-3, atol=1e-4)
        own = of_network(gained)[network]
        scaled = (gained[..., robot].ravel() - own.mean()) / own.std()
        np.testing.assert_allclose(batch.advantage[:, robot], scaled, rtol=1e-3, atol=1e-4)
    for row, (t, env, robot) in enumerate(np.ndindex(4, 3, 2)):
        chances = plain.chances(torch.from_numpy(done.observation[t, env]).double(), robot)
        ours = batch.chance.ravel()[row]
        assert float(ours) == pytest.approx(float(chances[done.action[t, env, robot]].detach()), rel=1e-4)


@given(
    seed=st.integers(0, 1000),
    networks=st.sampled_from([1, 2]),
    spread=st.floats(0.1, 100.0),
    offset=st.floats(-100.0, 100.0),
)
def test_returns_come_back_from_the_units_of_the_critics(seed, networks, spread, offset):
    scale, rng = ReturnScale(networks), np.random.default_rng(seed)
    returns = (rng.normal(size=(5, 4, 2)) * spread + offset).astype(np.float32)
    np.testing.assert_array_equal(scale.narrowed(returns), returns)
    np.testing.assert_array_equal(scale.widened(returns), returns)
    scale.add(returns)
    narrow = scale.narrowed(returns)
    whole = (0, 1) if networks == 2 else None
    np.testing.assert_allclose(narrow.mean(axis=whole), 0.0, atol=0.01)
    np.testing.assert_allclose(narrow.std(axis=whole), 1.0, rtol=0.02)
    np.testing.assert_allclose(scale.widened(narrow), returns, rtol=1e-4, atol=1e-4 * spread)


def test_equal_returns_are_not_blown_up():
    scale, returns = ReturnScale(2), np.full((4, 3, 2), 0.1, np.float32)
    scale.add(returns)
    assert np.abs(scale.narrowed(returns)).max() < 1e-3


@pytest.mark.parametrize("critic", ["own", "team"])
def test_robots_do_not_learn_from_each_other(critic):
    """What one robot is paid, however much, leaves the networks of the other as they are."""
    teams = []
    for factor in (1.0, 1000.0):
        algorithm, done = build(SMALL.changed(critic=critic)), rollout(3)
        take_in(algorithm, done._replace(reward=done.reward * np.float32([1.0, factor])))
        assert algorithm.update(0.5)
        teams.append(weights_of(algorithm))
    for name, array in teams[0].items():
        np.testing.assert_array_equal(array[0], teams[1][name][0])
    assert any(not np.array_equal(array[1], teams[1][name][1]) for name, array in teams[0].items())


@pytest.mark.parametrize(("critic", "matters"), [("own", False), ("team", True)])
@pytest.mark.parametrize("parameters", ["own", "shared"])
def test_a_critic_sees_the_others_only_where_it_is_the_teams(parameters, critic, matters):
    algorithm, seen = build(SMALL.changed(parameters=parameters, critic=critic)), rollout(0).observation
    other = seen.copy()
    other[..., 1, :] += 0.5
    with torch.no_grad():
        values = [algorithm._values(torch.from_numpy(one))[..., 0] for one in (seen, other)]
        logits = [algorithm._logits(torch.from_numpy(one))[..., 0, :] for one in (seen, other)]
    assert torch.equal(*logits)
    assert torch.equal(*values) is not matters


def test_every_decision_is_learned_from_once_in_an_epoch():
    algorithm = build(SMALL)
    batch = algorithm._prepared(rollout(0))
    parts = list(algorithm._minibatches(batch))
    assert [len(part.action) for part in parts] == [4, 4, 4] * 2
    orders = []
    for epoch in (parts[:3], parts[3:]):
        seen = torch.cat([part.observation for part in epoch])
        orders.append([batch.observation.tolist().index(one) for one in seen.tolist()])
        assert sorted(orders[-1]) == list(range(12))
        assert torch.equal(torch.cat([part.target for part in epoch]), batch.target[orders[-1]])
    assert orders[0] != orders[1]


def test_gradients_of_actor_and_critic_are_shortened_network_by_network():
    algorithm = build(SMALL.changed(gradient_norm=1e-3))
    take_in(algorithm, rollout(4))
    assert algorithm.update(0.0)["gradient_norm"] > 1e-3
    for layers in (algorithm.actor.parameters, algorithm.critic.parameters):
        squares = sum(one.grad.square().sum(dim=(1, 2)) for one in layers)
        np.testing.assert_allclose(squares.sqrt().numpy(), 1e-3, rtol=1e-2)


def test_blocked_moves_are_never_drawn():
    algorithm = build(SMALL.changed(mask=True), robots=1, names=BLOCKABLE)
    observation = np.zeros((2000, 1, 8), np.float32)
    observation[..., [0, 4, 1, 5]] = -1.0  # north and south
    counts = np.bincount(algorithm.act(observation, 0.0).ravel(), minlength=5)
    assert counts[:2].tolist() == [0, 0]
    assert counts[2:].min() > 500
    assert algorithm.actors().spec.mask


@four_kinds
def test_the_policy_is_what_the_actors_compute(parameters, critic):
    algorithm = build(SMALL.changed(parameters=parameters, critic=critic))
    spec, weights = algorithm.actors()
    assert (spec.input, spec.output, spec.activation) == ("own", "logits", "tanh")
    assert spec.of_robot == ((0, 1) if parameters == "own" else (0, 0))
    observation = np.random.default_rng(0).random((50, 2, 7), np.float32)
    with torch.no_grad():
        logits = algorithm._logits(torch.from_numpy(observation)).numpy()
    np.testing.assert_allclose(Networks(spec, weights).outputs(observation), logits, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("config", [SMALL, PqnConfig(rollout=4)])
def test_more_minibatches_than_decisions_are_refused_in_a_sentence(config):
    with pytest.raises(InputError) as caught:
        config.changed(minibatches=13).build(task(), np.random.SeedSequence(0))
    assert str(caught.value) == (
        "minibatches is 13, but must be a whole number from 1 to rollout * num_envs, 12."
    )
