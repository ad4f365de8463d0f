import numpy as np
import pytest

from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.protocol import LargeMemory
from tests.learning.algorithms.resuming import check_that_a_restored_one_goes_on_in_the_same_bits
from tests.learning.rollouts import build
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
    whole, rest = build(SMALL), build(SMALL, 1)
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
