"""Random numbers for many environments at once, each with a generator of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_MOST_AHEAD = 64
"""Decisions drawn at a time."""
_MOST_NUMBERS = 4_000_000
"""Numbers drawn at a time, of all environments together."""


def child(seed: np.random.SeedSequence, key: int) -> np.random.SeedSequence:
    """Return the child of a seed by its number; unlike `spawn`, it leaves the seed as it is."""
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, key))


class Chance:
    """Hands out numbers of one distribution, [envs, ...] at a time.

    Each environment has a generator, so its numbers do not depend on how many there are; they are drawn
    some decisions ahead, since a call of a generator costs more than the numbers.
    """

    def __init__(
        self,
        seeds: Sequence[np.random.SeedSequence],
        shape: tuple[int, ...],
        draw: Callable[[np.random.Generator, tuple[int, ...]], Floats],
    ) -> None:
        """`shape` is that of one environment's numbers; `draw` fills an array with them in their order."""
        self._rngs = [np.random.default_rng(seed) for seed in seeds]
        self._draw = draw
        each = max(1, len(seeds) * int(np.prod(shape)))
        self._numbers = np.empty((min(_MOST_AHEAD, max(1, _MOST_NUMBERS // each)), len(seeds), *shape))
        self._next = len(self._numbers)

    def next(self) -> Floats:
        """Return the next numbers, [envs, ...]; they are overwritten by later ones."""
        if self._next == len(self._numbers):
            ahead, _, *shape = self._numbers.shape
            for env, rng in enumerate(self._rngs):
                self._numbers[:, env] = self._draw(rng, (ahead, *shape))
            self._next = 0
        numbers: Floats = self._numbers[self._next]
        self._next += 1
        return numbers


def normal(seeds: Sequence[np.random.SeedSequence], shape: tuple[int, ...]) -> Chance:
    """Return standard normal numbers."""
    return Chance(seeds, shape, lambda rng, size: rng.standard_normal(size))


def uniform(seeds: Sequence[np.random.SeedSequence], shape: tuple[int, ...]) -> Chance:
    """Return numbers from 0 to 1, 1 left out."""
    return Chance(seeds, shape, lambda rng, size: rng.random(size))
