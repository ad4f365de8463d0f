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
        (5, "not 5."),
        (-1, "not -1."),
        (2**70, f"not {2**70}."),
        (True, "not True of type bool."),
        (1.0, "not 1.0 of type float."),
        (float("nan"), "not nan of type float."),
        (None, "not None of type NoneType."),
        ("north", "not 'north' of type str."),
        (np.array([1, 2]), "not an array of shape (2,) of type ndarray."),
        (np.array([]), "not an array of shape (0,) of type ndarray."),
    ],
)
def test_anything_else_is_one_sentence(action: object, end: str) -> None:
    with pytest.raises(InputError) as caught:
        checked_action("step: the action of robot_0", action, 5)
    assert str(caught.value) == f"step: the action of robot_0 must be an integer from 0 to 4, {end}"
