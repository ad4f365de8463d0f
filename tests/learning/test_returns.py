import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.learning.returns import Experience, MultiStepReturns


def decision(step, reward):
    observation = np.full((2, 3, 1), step, dtype=np.float32)
    action = np.full((2, 3), step % 5)
    return Experience(observation, action, np.full((2, 3), reward, dtype=np.float32), observation + 1)


@given(
    steps=st.integers(1, 5),
    discount=st.floats(0.0, 0.99),
    rewards=st.lists(st.floats(-5.0, 5.0, width=32), min_size=1, max_size=20),
)
def test_each_experience_sums_the_rewards_of_its_decisions(steps, discount, rewards):
    returns = MultiStepReturns(steps, discount)
    complete = [returns.add(decision(step, reward), False) for step, reward in enumerate(rewards)]
    assert complete[: steps - 1] == [None] * min(steps - 1, len(rewards))
    for last, experience in enumerate(complete[steps - 1 :], steps - 1):
        first = last - steps + 1
        total = sum(discount**k * rewards[first + k] for k in range(steps))
        assert experience.reward == pytest.approx(total, rel=1e-4, abs=1e-4)
        assert (experience.observation == first).all()
        assert (experience.action == first % 5).all()
        assert (experience.successor == last + 1).all()


def test_no_experience_reaches_over_the_end_of_an_episode():
    returns = MultiStepReturns(3, 0.9)
    ends = {4, 9}
    complete = [returns.add(decision(step, 1.0), step in ends) for step in range(12)]
    spans = [(int(e.observation[0, 0, 0]), int(e.successor[0, 0, 0])) for e in complete if e is not None]
    assert spans == [(0, 3), (1, 4), (2, 5), (5, 8), (6, 9), (7, 10)]
