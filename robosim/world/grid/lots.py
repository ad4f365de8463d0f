"""What chance decides in a decision of the grid: the robots' order, and where fresh pellets go."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK = 64
"""Decisions that are drawn at once: a draw for each environment and decision costs more than the moves."""


class Lots:
    """Draws from each environment's own generator, so that a batch draws as its members would alone."""

    def __init__(self, robots: int) -> None:
        self._robots = robots
        self._rngs: Sequence[np.random.Generator] = ()
        self._order: Integers = np.empty(0, dtype=np.int64)
        self._chance: Floats = np.empty(0)
        self._next = BLOCK

    def reset(self, rngs: Sequence[np.random.Generator]) -> None:
        """Draw from `rngs`, one for each environment, from now on."""
        self._rngs = rngs
        self._next = BLOCK

    def draw(self) -> tuple[Integers, Floats]:
        """Return the next decision's order of the robots and as many numbers from [0, 1), [envs, robots]."""
        if self._next == BLOCK:
            drawn = np.stack([rng.random((BLOCK, 2, self._robots)) for rng in self._rngs], axis=1)
            self._order = drawn[:, :, 0].argsort(axis=2)
            self._chance = drawn[:, :, 1].copy()
            self._next = 0
        self._next += 1
        return self._order[self._next - 1], self._chance[self._next - 1]
