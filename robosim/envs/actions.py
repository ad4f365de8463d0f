"""Checks of single actions, as the PettingZoo and Gymnasium faces are given them."""

from __future__ import annotations

import operator

import numpy as np

from robosim.errors import InputError, refused


def checked_action(place: str, action: object, num_actions: int) -> int:
    """Return `action` as an int in 0 .. num_actions - 1.

    Python and numpy integers are taken, an integer array of one element too (what a policy's argmax
    returns). Raises InputError for anything else: bools, floats and NaN among them.
    """
    if isinstance(action, np.ndarray) and action.size == 1:
        action = action.reshape(-1)[0]
    allowed = f"a whole number from 0 to {num_actions - 1}"
    if isinstance(action, bool | np.bool_):
        raise refused(place, action, allowed)
    try:
        index = operator.index(action)  # type: ignore[arg-type]  # checking is what this is for
    except TypeError:
        if isinstance(action, np.ndarray):
            raise InputError(f"{place} has the shape {list(action.shape)}, but must be {allowed}.") from None
        raise refused(place, action, allowed) from None
    if not 0 <= index < num_actions:
        raise refused(place, index, allowed)
    return index
