"""Seeds of the faces, as Gymnasium and PettingZoo mean them."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robosim.envs.config import EnvConfig
from robosim.envs.vector import MAX_SEED, VectorEnv
from robosim.errors import InputError, whole_number

_BITS = 63
"""Of a seed that nobody has given."""


def fresh_seed() -> int:
    """Return a seed from the machine's entropy, for an environment to which nobody has given one."""
    return secrets.randbits(_BITS)


def require_fields(fields: Mapping[str, Any], seeded_by: str) -> None:
    """Raise InputError for a name among the `fields` of a face that is no field of `EnvConfig`.

    A seed is none: faces whose episodes are seeded later, by `seeded_by`, would drop it without a word.
    """
    if "seed" in fields:
        raise InputError(f"seed is not an option of this environment: give it to {seeded_by}.")
    EnvConfig().require_options(fields)


class EpisodeSeed:
    """Begins the episodes of a batch of one environment, and knows the seed that they come from."""

    def __init__(self, env: VectorEnv) -> None:
        self._env = env
        self.seed: int | None = None
        """What `begin` was last given, or has drawn; with it the same episodes begin again."""

    def begin(self, seed: int | None) -> NDArray[np.float32]:
        """Begin an episode; returns the observations [1, robots, size].

        With `seed` it is the seed's first episode. Without one it is the next episode of the seed before, or,
        if there was none, the first of a seed drawn from the machine's entropy: copies of an environment
        differ. InputError for a seed out of range.
        """
        if seed is None and self.seed is not None:
            return self._env.reset()
        drawn = fresh_seed() if seed is None else whole_number("seed", seed, 0, MAX_SEED)
        observation = self._env.reset(drawn)
        self.seed = drawn
        return observation
