import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.learning.algorithms.dqn.returns import MultiStepReturns
from robosim.learning.algorithms.protocol import Experience

ROBOTS = 3


def decision(step, rewards, terminated=None, truncated=None):
    """Decision number `step` of some environments, each of which has its own reward and end."""
    envs = len(rewards)
    never = np.zeros(envs, bool)
    observation = np.empty((envs, ROBOTS, 2), np.float32)
    observation[..., 0], observation[..., 1] = step, np.arange(envs)[:, None]
    reward = np.repeat(np.float32(rewards)[:, None], ROBOTS, axis=1)
    final = observation + np.float32([0.5, 0.0])
    return Experience(
        observation, np.full((envs, ROBOTS), step % 5), reward, final, final,
        never if terminated is None else np.array(terminated),
        never if truncated is None else np.array(truncated),
    )  # fmt: skip


def rows(transitions):
    """(environment, first decision, last decision, return, whether it goes on) of each transition."""
    if transitions is None:
        return []
    for part in transitions:
        assert len(part) == len(transitions.reward)
    first, successor = transitions.observation[:, 0], transitions.successor[:, 0]
    assert (first[:, 1] == successor[:, 1]).all()
    assert (transitions.action == first[:, :1] % 5).all()
    together = zip(first, successor, transitions.reward[:, 0], transitions.continues[:, 0], strict=True)
    return [(int(f[1]), int(f[0]), int(s[0]), float(r), bool(c)) for f, s, r, c in together]


@given(
    steps=st.integers(1, 5),
    discount=st.floats(0.0, 0.99),
    length=st.integers(1, 20),
    seed=st.integers(0, 1000),
)
def test_every_decision_is_kept_or_dropped_as_its_own_episode_ends(steps, discount, length, seed):
    """Against a plain loop over one environment after the other, whose episodes end when they do."""
    envs, rng = 3, np.random.default_rng(seed)
    rewards = rng.uniform(-5, 5, (length, envs)).astype(np.float32)
    ends = rng.choice(3, size=(length, envs), p=[0.7, 0.15, 0.15])  # goes on, terminated, truncated
    returns, kept = MultiStepReturns(steps, discount), []
    for step in range(length):
        kept += rows(returns.add(decision(step, rewards[step], ends[step] == 1, ends[step] == 2)))
    expected = []
    for env in range(envs):
        for first in range(length):
            total = 0.0
            for k in range(steps):
                last = first + k
                if last >= length:
                    break
                total += discount**k * float(rewards[last, env])
                over = ends[last, env] == 1
                if over or k == steps - 1:
                    expected.append((env, first, last, pytest.approx(total, rel=1e-4, abs=1e-4), not over))
                    break
                if ends[last, env] == 2:
                    break
    assert sorted(kept, key=lambda row: row[:3]) == sorted(expected, key=lambda row: row[:3])


def test_no_experience_reaches_over_the_end_of_an_episode():
    returns = MultiStepReturns(3, 0.9)
    ends = {4, 9}
    complete = [
        row for step in range(12) for row in rows(returns.add(decision(step, [1.0], None, [step in ends])))
    ]
    assert [row[1:3] for row in complete] == [(0, 2), (1, 3), (2, 4), (5, 7), (6, 8), (7, 9)]


def test_the_end_of_a_task_keeps_its_last_decisions():
    returns = MultiStepReturns(3, 0.5)
    complete = [rows(returns.add(decision(step, [1.0, 1.0], [step == 1, False]))) for step in range(3)]
    assert complete[0] == []
    assert complete[1] == [(0, 0, 1, 1.5, False), (0, 1, 1, 1.0, False)]
    assert complete[2] == [(1, 0, 2, 1.75, True)]


def test_a_restored_one_goes_on_with_what_was_open():
    whole, first, rest = (MultiStepReturns(3, 0.9) for _ in range(3))
    for step in range(4):
        for either in (whole, first):
            either.add(decision(step, [1.0, 2.0], None, [step == 2, False]))
    rest.restore(first.state())
    for step in range(4, 8):
        one, other = (rows(either.add(decision(step, [1.0, 2.0]))) for either in (whole, rest))
        assert one == other != []
    fresh = MultiStepReturns(3, 0.9)
    rest.restore(fresh.state())
    assert rows(rest.add(decision(0, [1.0]))) == []
