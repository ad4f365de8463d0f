import numpy as np
import pytest

from robosim.envs.actions import checked_action
from robosim.errors import InputError


@pytest.mark.parametrize("action", [3, np.int64(3), np.uint8(3), np.array(3), np.array([3]), np.array([[3]])])
def test_integers_of_every_kind_are_taken(action: object) -> None:
    assert checked_action("action", action, 5) == 3


@pytest.mark.parametrize(
    ("action", "end"),
    [
        (5, "is 5"),
        (-1, "is -1"),
        (2**70, f"is {2**70}"),
        (True, "is true"),
        (1.0, "is 1.0"),
        (float("nan"), "is nan"),
        (None, "is None"),
        ("north", 'is "north"'),
        (np.array([1, 2]), "has the shape [2]"),
        (np.array([]), "has the shape [0]"),
    ],
)
def test_anything_else_is_one_sentence(action: object, end: str) -> None:
    with pytest.raises(InputError) as caught:
        checked_action("step: the action of robot_0", action, 5)
    assert str(caught.value) == f"step: the action of robot_0 {end}, but must be a whole number from 0 to 4."
