from itertools import pairwise

import numpy as np
import pytest
import torch

from robosim.control.network import Networks, NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.maddpg import MaddpgConfig, straight_through
from robosim.learning.algorithms.protocol import LargeMemory
from tests.learning import rollouts
from tests.learning.algorithms.resuming import check_that_a_restored_one_goes_on_in_the_same_bits
from tests.learning.plain import plain_networks
from tests.learning.rollouts import BLOCKABLE, one_by_one, rollout, take_in
from tests.learning.walking import deliveries, learned

SMALL = MaddpgConfig(
    hidden=(16, 8), warmup=4, batch_size=6, replay_capacity=50, updates_per_step=1.0, learning_rate_end=1.0
)


def build(config=SMALL, seed=0, start=None, robots=3, **changes):
    return rollouts.build(config, seed, start, robots=robots, **changes)


def filled(config=SMALL, seed=0, decisions=12, **changes):
    algorithm = build(config, seed, **changes)
    take_in(algorithm, rollout(5, decisions, robots=algorithm.task.robots, size=algorithm.task.size))
    return algorithm


def drawn_like(algorithm):
    """Return the batch and the Gumbel numbers [robots, transitions, actions] that come next."""
    rng = np.random.default_rng()
    rng.bit_generator.state = algorithm._draw.bit_generator.state
    batch = algorithm._batch
    algorithm.replay.sample(rng, batch, together=True)
    return batch, torch.from_numpy(rng.gumbel(size=(*batch.rewards.shape[:2], 5)).astype(np.float32))


def seen_by_critics(observations, actions):
    """Return all robots' observations and one-hots, robot by robot, for one transition after another."""
    rows = zip(observations.unbind(1), actions.unbind(1), strict=True)
    return torch.stack([torch.cat([torch.cat(pair) for pair in zip(*row, strict=True)]) for row in rows])


@pytest.mark.parametrize("most", [10.0, 0.01])
def test_updates_equal_plain_maddpg_one_robot_at_a_time(most):
    """Losses, clipped gradients, Adam's steps and targets, written with torch's own modules."""
    config = SMALL.changed(gradient_norm=most, logit_weight=0.1, tau=0.2)
    ours = filled(config)
    ours._decisions = config.warmup
    nets = {name: plain_networks(getattr(ours, name).online) for name in ("actor", "critic")}
    targets = {name: plain_networks(getattr(ours, name).target) for name in nets}
    adams = {name: [torch.optim.Adam(one.parameters(), 1e-3) for one in nets[name]] for name in nets}
    one_hot = torch.eye(5)
    for _ in range(4):
        batch, noise = drawn_like(ours)
        figures = {"policy_loss": [], "value_loss": [], "gradient_norm": []}
        with torch.no_grad():
            best = torch.stack(
                [net(row).argmax(-1) for net, row in zip(targets["actor"], batch.successors, strict=True)]
            )
        now = seen_by_critics(batch.observations, one_hot[batch.actions[..., 0]])
        after = seen_by_critics(batch.successors, one_hot[best])
        for i, critic in enumerate(nets["critic"]):
            with torch.no_grad():
                follows = batch.continues[i] * targets["critic"][i](after)
            loss = (critic(now) - 0.1 * batch.rewards[i] - 0.95 * follows).square().mean()
            adams["critic"][i].zero_grad()
            loss.backward()
            norm = torch.nn.utils.clip_grad_norm_(critic.parameters(), most)
            adams["critic"][i].step()
            figures["value_loss"].append(loss.item())
            figures["gradient_norm"].append(norm.item())
        logits = [net(row) for net, row in zip(nets["actor"], batch.observations, strict=True)]
        draws = [torch.softmax(row + noise[i], -1) for i, row in enumerate(logits)]
        draws = [one_hot[soft.argmax(-1)] + soft - soft.detach() for soft in draws]
        for i in range(3):
            actions = torch.stack([draw if j == i else draw.detach() for j, draw in enumerate(draws)])
            value = nets["critic"][i](seen_by_critics(batch.observations, actions)).mean()
            adams["actor"][i].zero_grad()
            (-value + 0.1 * logits[i].square().mean()).backward()
            torch.nn.utils.clip_grad_norm_(nets["actor"][i].parameters(), most)
            adams["actor"][i].step()
            figures["policy_loss"].append(-value.item())
        for name, nets_of in nets.items():
            for net, target in zip(nets_of, targets[name], strict=True):
                for one, other in zip(net.parameters(), target.parameters(), strict=True):
                    other.data.mul_(0.8).add_(0.2 * one.data)
        ours._decisions += 1  # by which one update is due
        found = ours.update(0.0)
        for name, each in figures.items():
            assert found[name] == pytest.approx(np.mean(each), rel=1e-3)
        for name in nets:
            for part, plain in (("online", nets), ("target", targets)):
                stacked = plain_networks(getattr(getattr(ours, name), part))
                for mine, theirs in zip(stacked, plain[name], strict=True):
                    for one, other in zip(mine.parameters(), theirs.parameters(), strict=True):
                        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
    assert ours.updates == 4


def test_a_draw_is_one_hot_and_has_the_gradient_of_the_softmax():
    scores = torch.randn(50, 5, generator=torch.Generator().manual_seed(0), requires_grad=True)
    along = torch.randn(50, 5, generator=torch.Generator().manual_seed(1))
    drawn = straight_through(scores)
    torch.testing.assert_close(drawn, torch.eye(5)[scores.argmax(-1)])
    (hard,) = torch.autograd.grad((drawn * along).sum(), scores)
    (soft,) = torch.autograd.grad((scores.softmax(-1) * along).sum(), scores)
    assert torch.equal(hard, soft)


def test_robots_draw_what_their_actors_find_likely():
    algorithm = build()
    observation = np.repeat(np.random.default_rng(0).random((1, 3, 7), np.float32), 20_000, axis=0)
    acted = algorithm.act(observation, 0.0)
    spec, weights = algorithm.actors()
    logits = torch.from_numpy(Networks(spec, weights).outputs(observation[:1])[0])
    for robot, likely in enumerate(logits.softmax(-1).numpy()):
        assert np.bincount(acted[:, robot], minlength=5) / 20_000 == pytest.approx(likely, abs=0.015)


def test_what_one_robot_is_paid_reaches_its_own_critic_and_actor_alone_at_first():
    """Later it reaches the others through what it does, which their critics see."""
    teams = []
    for factor in (1.0, 50.0):
        algorithm, done = build(SMALL.changed(updates_per_step=1 / 32)), rollout(5, 12, robots=3)
        take_in(algorithm, done._replace(reward=done.reward * np.float32([1.0, 1.0, factor])))
        assert algorithm.update(0.5)
        assert algorithm.updates == 1
        critics = {f"critic.{name}": one.numpy() for name, one in algorithm.critic.online.named().items()}
        teams.append(algorithm.actors().weights | critics)
    for name, array in teams[0].items():
        np.testing.assert_array_equal(array[:2], teams[1][name][:2])
    for part in ("", "critic."):
        assert any(
            not np.array_equal(array[2], teams[1][name][2])
            for name, array in teams[0].items()
            if name.startswith(part) and ("critic" in name) == bool(part)
        )


def test_blocked_moves_are_never_drawn_nor_taken_by_targets():
    algorithm = filled(SMALL.changed(mask=True), robots=1, names=BLOCKABLE)
    observation = np.zeros((2000, 1, 8), np.float32)
    observation[..., [0, 4, 1, 5]] = -1.0  # north and south
    counts = np.bincount(algorithm.act(observation, 0.0).ravel(), minlength=5)
    assert counts[:2].tolist() == [0, 0]
    assert counts[2:].min() > 100
    algorithm._batch.pairs[:] = torch.from_numpy(observation[:6]).transpose(0, 1)
    # Target critics are asked for no move that is blocked, whatever the target actor finds best.
    algorithm.actor.target.biases[-1][..., :2] = 100.0
    batch, one_hot = algorithm._batch, torch.eye(5)
    batch.numbers.uniform_(0, 1)
    (actor,), (critic,) = (plain_networks(one.target) for one in (algorithm.actor, algorithm.critic))
    with torch.no_grad():
        best = 2 + actor(batch.successors[0])[:, 2:].argmax(-1)
        follows = critic(torch.cat((batch.successors[0], one_hot[best]), -1))
        goal = 0.1 * batch.rewards[0] + 0.95 * batch.continues[0] * follows
        value = critic(torch.cat((batch.observations[0], one_hot[batch.actions[0, :, 0]]), -1))
    loss = algorithm._value_loss(batch).item()
    assert loss == pytest.approx((value - goal).square().mean().item(), rel=1e-4)
    losses = algorithm._policy_losses(algorithm._batch)
    assert 0 < losses.entropy.item() <= np.log(3) + 1e-6
    algorithm.actor.step(losses.policy, 1e-3, 10.0)
    assert torch.isfinite(algorithm.actor.online.flat).all()
    assert algorithm.actors().spec.mask
    # Where observations hold no gains, there is nothing to mask by.
    assert not build(SMALL.changed(mask=True)).actors().spec.mask


def test_updates_are_as_many_as_are_due():
    algorithm, counts = build(SMALL.changed(updates_per_step=0.25, warmup=6)), []
    for decision in one_by_one(rollout(0, 7, robots=3)):
        assert bool(algorithm.update(0.0)) == (algorithm.updates > (counts or [0])[-1])
        counts.append(algorithm.updates)
        algorithm.observe(decision)
    assert counts == [0, 0, 0, 0, 1, 2, 3]


@pytest.mark.parametrize("decisions", [1, 9, 30])
@pytest.mark.parametrize("return_steps", [1, 3])
def test_it_goes_on_in_the_same_bits(decisions, return_steps):
    config = SMALL.changed(return_steps=return_steps)
    whole, rest = build(config), build(config, seed=7)
    assert isinstance(whole, LargeMemory)
    check_that_a_restored_one_goes_on_in_the_same_bits(whole, rest, decisions)


def test_the_policy_is_what_the_actors_compute():
    algorithm = filled()
    algorithm.update(0.0)
    spec, weights = algorithm.actors()
    assert (spec.output, spec.activation, spec.of_robot) == ("logits", "relu", (0, 1, 2))
    assert [array.shape[1:] for name, array in weights.items() if "weight" in name] == list(
        pairwise((7, 16, 8, 5))
    )
    observation = np.random.default_rng(0).random((50, 3, 7), np.float32)
    plain = plain_networks(algorithm.actor.online)
    with torch.no_grad():
        logits = torch.stack([net(torch.from_numpy(observation[:, i])) for i, net in enumerate(plain)], 1)
    np.testing.assert_allclose(Networks(spec, weights).outputs(observation), logits, rtol=1e-4, atol=1e-6)


def test_it_starts_from_actors_of_its_own_kind():
    first = build().actors()
    # Arrays go by their names: files keep them in another order.
    start = first._replace(weights=dict(sorted(first.weights.items())))
    second = build(SMALL.starting_from(first.spec), 1, start)
    for name, array in second.actors().weights.items():
        np.testing.assert_array_equal(array, first.weights[name])
    assert torch.equal(second.actor.target.flat, second.actor.online.flat)
    assert SMALL.starting_from(first.spec.changed(mask=True)).mask
    with pytest.raises(InputError) as caught:
        SMALL.starting_from(NetworkSpec(inputs=7, hidden=(16, 8), of_robot=(0,)))
    assert str(caught.value) == (
        'has networks of ["own", "relu", "none", "action values", [16, 8]], but must have ones of '
        '["own", "relu", "none", "logits", [16, 8]] for the algorithm "maddpg" (input, activation, '
        "normalisation, output, hidden)."
    )


def test_what_does_not_fit_is_one_sentence():
    state = build(SMALL.changed(hidden=(16, 9))).state()
    with pytest.raises(InputError) as caught:
        build().restore(state)
    assert str(caught.value) == ("a layer of the checkpoint has the shape (993,), but must have (927,).")
    many = tuple(f"number {i}" for i in range(1000))
    with pytest.raises(InputError) as caught:
        build(SMALL.changed(replay_capacity=10**8), names=many, decisions=10**9)
    assert str(caught.value) == (
        "replay_capacity is 100000000, but must be less: 3 robots with observations of 1000 numbers need "
        "more memory than there is."
    )


def test_it_learns_to_walk_a_corridor_to_and_fro(corridor):
    config = MaddpgConfig(
        hidden=(32, 32),
        learning_rate=5e-3,
        discount=0.9,
        return_steps=3,
        batch_size=64,
        warmup=200,
        tau=0.05,
        logit_weight=0.03,
        reward_scale=1.0,
    )
    loop = learned(corridor(robots=2, num_envs=8), config, 4000)
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert deliveries(corridor, loop.algorithm, 2).min() >= 9
    figures = loop.log.rows[-1].figures
    assert set(figures) == {"policy_loss", "value_loss", "entropy", "gradient_norm", "learning_rate"}


@pytest.mark.parametrize("device", ["tpu", "cuda:97"])
def test_a_device_that_is_not_there_is_refused(device):
    with pytest.raises(InputError, match=f'device is "{device}", but must be "cpu"'):
        build(SMALL.changed(device=device))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_a_gpu_learns_what_the_processor_learns():
    both = [filled(), filled(SMALL.changed(device="cuda"))]
    figures = [one.update(0.0) for one in both]
    assert figures[0] == pytest.approx(figures[1], rel=1e-3)
    states = [one.state() for one in both]
    assert states[0].facts == states[1].facts
    for name, tensor in states[0].tensors.items():
        torch.testing.assert_close(tensor, states[1].tensors[name], rtol=1e-3, atol=1e-4)
    # Saved on one, it goes on on the other.
    again = build(SMALL.changed(device="cuda"))
    again.restore(states[0])
    for name, tensor in states[0].tensors.items():
        torch.testing.assert_close(tensor, again.state().tensors[name])
