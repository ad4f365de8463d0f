"""Checks of single actions, as the PettingZoo and Gymnasium faces are given them."""

from __future__ import annotations

import operator

import numpy as np

from robosim.errors import InputError


def checked_action(place: str, action: object, num_actions: int) -> int:
    """Return `action` as an int in 0 .. num_actions - 1.

    Python and numpy integers are taken, an integer array of one element too (what a policy's argmax
    returns). Raises InputError for anything else: bools, floats and NaN among them.
    """
    if isinstance(action, np.ndarray) and action.size == 1:
        action = action.reshape(-1)[0]
    allowed = f"an integer from 0 to {num_actions - 1}"
    if isinstance(action, bool | np.bool_):
        raise InputError(f"{place} must be {allowed}, not {action!r} of type {type(action).__name__}.")
    try:
        index = operator.index(action)  # type: ignore[arg-type]  # checking is what this is for
    except TypeError:
        shown = f"an array of shape {action.shape}" if isinstance(action, np.ndarray) else repr(action)
        raise InputError(f"{place} must be {allowed}, not {shown} of type {type(action).__name__}.") from None
    if not 0 <= index < num_actions:
        raise InputError(f"{place} must be {allowed}, not {index}.")
    return index
