"""Errors that users meet as one sentence: wrong input, and work of which a part could not be done."""

from __future__ import annotations

import difflib
import json
import os
from collections.abc import Iterable

import numpy as np

_LONGEST_LINE = 1000
"""Characters of a sentence: a path may take some hundreds."""
_MOST_LINES = 50


class InputError(ValueError):
    """Wrong input: one sentence that names the place, the value and what is allowed.

    The command line prints the sentence and exits with code 2. Whatever it repeats of the input cannot steer
    a terminal, nor fill it: lines are made printable and cut.
    """

    def __init__(self, sentence: object = "") -> None:
        lines = str(sentence).split("\n")
        if len(lines) > _MOST_LINES:
            lines[_MOST_LINES:] = [f"... and {len(lines) - _MOST_LINES} more."]
        super().__init__("\n".join(printable(line, _LONGEST_LINE) for line in lines))


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


def printable(text: str, most: int = 80) -> str:
    """Return a text in one line of at most `most` characters, with marks for those that do not print."""
    line = without_controls(text[: most + 1].replace("\n", " ").replace("\t", " "))
    return line if len(text) <= most else line[: most - 4] + " ..."


def without_controls(text: str) -> str:
    """Return a text that cannot steer a terminal: with marks for characters that do not print."""
    return "".join(character if character.isprintable() else "?" for character in text)


def shown(value: object) -> str:
    """Write a value as a file would, in one printable line that is not too long."""
    if isinstance(value, str | bool):
        # More of a text than is shown need not be written.
        text = json.dumps(value[:100] if isinstance(value, str) else value)
    elif isinstance(value, list | tuple):
        more = ", ..." if len(value) > 9 else ""
        text = "[" + ", ".join(shown(part) for part in value[:9]) + more + "]"
    elif isinstance(value, dict):
        text = "a table"
    elif isinstance(value, int) and abs(value) > 10**30:
        text = "a whole number of more than 30 digits"
    else:
        text = " ".join(str(value).split())
    return printable(text)


def refused(place: str, value: object, allowed: str) -> InputError:
    """Return the error for a value: one sentence that names the place, the value and what is allowed."""
    return InputError(f"{place} is {shown(value)}, but must be {allowed}.")


def name_or_path(place: str, value: object) -> str:
    """Return the text of a name or a path; InputError for what is neither."""
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str):
        raise refused(place, value, "a name or a path")
    return text


def whole_number(place: str, value: object, low: int, high: int) -> int:
    """Return `value` as an int; InputError unless it is a whole number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not low <= value <= high:
        raise refused(place, value, f"a whole number from {low} to {high}")
    return int(value)
