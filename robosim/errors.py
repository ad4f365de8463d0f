"""The one error that a user can cause and can mend."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Wrong input: one sentence that names the place, the value and what is allowed.

    The command line prints the sentence and exits with code 2.
    """


def nearest_names(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence that offers the names most like `name`."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
    if near:
        return f"did you mean {' or '.join(near)}?"
    return f"known names are {', '.join(names)}."
