"""Errors that users meet as one sentence: wrong input, and work of which a part could not be done."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable

import numpy as np


class InputError(ValueError):
    """Wrong input: one sentence that names the place, the value and what is allowed.

    The command line prints the sentence and exits with code 2.
    """


class IncompleteError(Exception):
    """Some of the work that was asked for could not be done, and has been reported; the rest is done.

    The command line prints the sentence and exits with code 1.
    """


def nearest_names(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence that offers the names most like `name`."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    if near:
        return f"did you mean {' or '.join(near)}?"
    return f"known names are {', '.join(names)}."


def shown(value: object) -> str:
    """Write a value as a file would, in one printable line that is not too long."""
    if isinstance(value, str | bool):
        text = json.dumps(value)
    elif isinstance(value, list | tuple):
        more = ", ..." if len(value) > 9 else ""
        text = "[" + ", ".join(shown(part) for part in value[:9]) + more + "]"
    elif isinstance(value, dict):
        text = "a table"
    elif isinstance(value, int) and abs(value) > 10**30:
        text = "a whole number of more than 30 digits"
    else:
        text = " ".join(str(value).split())
    text = "".join(character if character.isprintable() else "?" for character in text)
    return text if len(text) <= 80 else text[:76] + " ..."


def refused(place: str, value: object, allowed: str) -> InputError:
    """Return the error for a value: one sentence that names the place, the value and what is allowed."""
    return InputError(f"{place} is {shown(value)}, but must be {allowed}.")


def whole_number(place: str, value: object, low: int, high: int) -> int:
    """Return `value` as an int; InputError unless it is a whole number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not low <= value <= high:
        raise refused(place, value, f"a whole number from {low} to {high}")
    return int(value)
