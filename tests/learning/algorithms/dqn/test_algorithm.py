import numpy as np
import pytest

from robosim.errors import InputError
from robosim.learning.actors import FrozenTeam
from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.protocol import LargeMemory
from tests.learning.algorithms.resuming import check_that_a_restored_one_goes_on_in_the_same_bits
from tests.learning.rollouts import build, rollout, take_in
from tests.learning.walking import deliveries, learned, loop_in, task_in

SMALL = DqnConfig(hidden=(8,), warmup=4, batch_size=4, return_steps=2, replay_capacity=50)


class OneDelivery:
    """A corridor whose task is over, in each environment by itself, as soon as its first robot delivers."""

    def __init__(self, env):
        self._env = env
        self.robots, self.num_envs, self.layout = env.robots, env.num_envs, env.layout
        self.joint_decisions = env.joint_decisions
        self.num_actions = env.num_actions
        self.steps = []

    def reset(self):
        return self._env.reset()

    def step(self, actions):
        before = self._env.delivered.copy()
        done = self._env.step(actions)
        over = (done.final_delivered > before)[:, 0] & ~done.truncated
        self._env._cell[over], self._env._laden[over] = 2, False
        # Not in place: the totals just returned are this very array.
        self._env.delivered = np.where(over[:, None], 0, self._env.delivered)
        observation = np.where(over[:, None, None], self._env._observe(), done.observation)
        self.steps.append(done._replace(terminated=over, observation=observation))
        return self.steps[-1]


@pytest.mark.parametrize("parameters", ["own", "shared"])
def test_it_learns_where_tasks_end_at_different_times(corridor, parameters):
    config = DqnConfig(
        parameters=parameters, hidden=(32, 32), warmup=200, discount=0.9, exploration=0.5, reward_scale=1.0
    )
    env = OneDelivery(corridor(robots=1, num_envs=4))
    loop = learned(env, config, 4000)
    ended = np.array([step.terminated for step in env.steps])
    assert (ended.any(axis=1) & ~ended.all(axis=1)).sum() > 40
    kept = loop.algorithm.export(*loop.algorithm.held())
    assert 0.0 < float(kept["continues"].mean()) < 1.0
    assert deliveries(corridor, loop.algorithm, 1).min() >= 9


def test_metrics_count_each_environment_s_own_episodes(corridor):
    env = OneDelivery(corridor(robots=1, num_envs=3))
    # At random all the time, which delivers now and then.
    loop = loop_in(env, SMALL.changed(epsilon_end=1.0, epsilon_spread=0.0), 4000)
    while not loop.finished:
        loop.advance()
    total, episodes, before = 0, 0, np.zeros(3, np.int64)
    for step in env.steps:
        now, ended = step.final_delivered.sum(axis=1), step.terminated | step.truncated
        total += int((now - before).sum())
        episodes += int(ended.sum())
        before = np.where(ended, 0, now)
    assert any(step.terminated.any() for step in env.steps)
    assert loop.log.sums.episodes == episodes
    assert sum(row.delivered for row in loop.log.rows) == total > 0


def test_its_replay_is_a_large_memory_and_it_goes_on_in_the_same_bits():
    whole, rest = build(SMALL, decisions=1000), build(SMALL, 1, decisions=1000)
    assert isinstance(whole, LargeMemory)
    check_that_a_restored_one_goes_on_in_the_same_bits(whole, rest, 60)
    first, last = whole.held()
    assert first > 0
    assert last - first == 50
    assert whole.update(0.5)["loss"] >= 0.0


def test_figures_follow_exploration_and_step_size(corridor):
    algorithm = SMALL.build(task_in(corridor(), 1000), np.random.SeedSequence(0))
    figures = algorithm.update(0.05)
    assert figures["epsilon"] == pytest.approx(0.51)
    assert figures["learning_rate"] == pytest.approx(1e-3 * (1 - 0.98 * 0.05))
    assert np.isnan(figures["loss"])
    kept = SMALL.build(task_in(corridor(), 1000, explores=False), np.random.SeedSequence(0))
    assert kept.update(0.0)["epsilon"] == 0.02


def taught(config, groups, order=(0, 1, 2, 3)):
    """Return a learner of four robots after some experience, that of the robots in another order."""
    algorithm = build(config, robots=4, groups=groups)
    for seed in range(6):
        done = rollout(seed, robots=4)
        turned = {
            name: value[:, :, list(order)]
            for name, value in done._asdict().items()
            if name not in ("terminated", "truncated")
        }
        take_in(algorithm, done._replace(**turned))
        algorithm.update(0.1)
    assert algorithm.learner.updates > 5
    return algorithm


@pytest.mark.parametrize(
    ("groups", "same", "order"),
    [
        ((0, 1, 2, 3), {"parameters": "own"}, (0, 1, 2, 3)),
        ((0, 0, 0, 0), {"parameters": "shared"}, (0, 1, 2, 3)),
        ((), {"parameters": "shared"}, (0, 1, 2, 3)),
        ((0, 1, 0, 1), {"parameters": "group", "groups": (0, 0, 1, 1)}, (0, 2, 1, 3)),
    ],
)
def test_a_network_a_group_learns_as_its_robots_would_by_themselves(groups, same, order):
    """A group of one is a robot of its own, one group of all shares; their numbers do not matter."""
    own = taught(SMALL.changed(parameters="group"), groups)
    others_groups = same.pop("groups", ())
    other = taught(SMALL.changed(**same), others_groups, order)
    weights, others = own.actors().weights, other.actors().weights
    assert all(np.array_equal(weights[name], others[name]) for name in others)
    assert own.actors().spec.of_robot == (groups or (0,) * 4)
    seen = np.random.default_rng(1).random((3, 4, 7), np.float32)
    # At the end of a stage that explores no more, robots do what their group's network says.
    best = [FrozenTeam(one.actors()) for one in (own, other)]
    assert np.array_equal(best[0].act(seen)[:, list(order)], best[1].act(seen[:, list(order)]))
    quiet = SMALL.changed(parameters="group", epsilon_end=0.0, epsilon_spread=0.0, exploration=0.0)
    learner = taught(quiet, groups)
    assert np.array_equal(learner.act(seen, 1.0), FrozenTeam(learner.actors()).act(seen))


def test_groups_of_unequal_size_and_networks_to_start_from_are_refused():
    config = SMALL.changed(parameters="group")
    with pytest.raises(InputError) as error:
        build(config, robots=3, groups=(0, 1, 0))
    assert str(error.value) == (
        'parameters is "group", but must be "own" or "shared" where groups have [2, 1] robots: their '
        "networks learn side by side from as many each."
    )
    with pytest.raises(InputError) as error:
        config.starting_from(build(SMALL).actors().spec)
    assert str(error.value) == 'cannot be gone on from where parameters is "group", but must be left out.'
