"""Keys, by which a job and its record know each other."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from robosim.errors import InputError


def key_of(config: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a configuration's canonical JSON: the same for equal ones, in any order of names.

    InputError for what JSON cannot hold.
    """
    try:
        text = json.dumps(config, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"a job's configuration must be numbers, texts, lists and tables: {error}."
        ) from None
    return hashlib.sha256(text.encode()).hexdigest()
