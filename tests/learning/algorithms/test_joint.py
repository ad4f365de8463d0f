import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robosim.learning.algorithms.joint import combine_actions, split_actions


@given(robots=st.integers(1, 8), actions=st.integers(2, 5), data=st.data())
def test_combinations_are_numbered_with_the_first_robot_as_the_first_digit(robots, actions, data):
    chosen = np.array(data.draw(st.lists(st.integers(0, actions - 1), min_size=robots, max_size=robots)))
    number = 0
    for action in chosen:
        number = number * actions + action
    digits = (actions,) * robots
    assert combine_actions(chosen[None], digits).tolist() == [number]
    np.testing.assert_array_equal(split_actions(np.array([number]), digits), chosen[None])


def test_each_combination_has_its_own_number():
    every = np.array(list(itertools.product(range(5), repeat=3)))
    assert combine_actions(every, (5, 5, 5)).tolist() == list(range(125))
