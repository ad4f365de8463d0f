"""Experience replay: each robot keeps and samples its own transitions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


class Batch(NamedTuple):
    """Transitions drawn from the replay."""

    observations: Tensor
    """[robots, 2 * batch, size]: even rows are observations, odd rows what followed each."""
    actions: Tensor
    """[robots, batch, 1], int64."""
    rewards: Tensor
    """[robots, batch]."""


class Replay:
    """Ring of the latest `capacity` transitions of every robot.

    It takes `robots * capacity * (8 * size + 12)` bytes, reserved at once and touched as it fills.
    An observation and its successor lie side by side in one row, so that one flat `index_select`
    fetches both, and one pass of the network serves both.
    """

    def __init__(self, robots: int, capacity: int, size: int) -> None:
        self.capacity = capacity
        self.length = 0
        """Transitions held of each robot."""
        self._next = 0
        self._robots = robots
        self._size = size
        self._observations = torch.empty(robots * capacity, 2 * size)
        self._actions = torch.empty(robots * capacity, dtype=torch.int64)
        self._rewards = torch.empty(robots * capacity)
        self._offsets = np.arange(robots, dtype=np.int64)[:, None] * capacity

    def add(
        self,
        observations: NDArray[np.float32],
        actions: NDArray[np.int64],
        rewards: NDArray[np.float32],
        successors: NDArray[np.float32],
    ) -> None:
        """Store one transition of every robot in every environment.

        `observations` and `successors` are [envs, robots, size], `actions` and `rewards` [envs, robots].
        """
        envs = len(observations)
        places = (self._next + np.arange(envs)) % self.capacity
        rows = torch.from_numpy((places[:, None] + self._offsets[:, 0]).ravel())
        pairs = np.concatenate((observations, successors), axis=-1).reshape(-1, 2 * self._size)
        self._observations.index_copy_(0, rows, torch.from_numpy(pairs))
        self._actions.index_copy_(0, rows, torch.from_numpy(actions.reshape(-1)))
        self._rewards.index_copy_(0, rows, torch.from_numpy(rewards.reshape(-1)))
        self._next = int(places[-1] + 1) % self.capacity
        self.length = min(self.length + envs, self.capacity)

    def sample(self, batch: int, rng: np.random.Generator) -> Batch:
        """Draw `batch` transitions of each robot, uniformly and independently, with replacement."""
        drawn = rng.integers(self.length, size=(self._robots, batch)) + self._offsets
        rows = torch.from_numpy(drawn.ravel())
        return Batch(
            self._observations.index_select(0, rows).view(self._robots, 2 * batch, self._size),
            self._actions.index_select(0, rows).view(self._robots, batch, 1),
            self._rewards.index_select(0, rows).view(self._robots, batch),
        )
