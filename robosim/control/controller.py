"""Controllers: whatever chooses actions for a whole team, scripted or learned."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robosim.envs.vector import VectorEnv

Actions = NDArray[np.int64]


class Controller(Protocol):
    """Chooses the actions of all robots of a batch of environments."""

    name: str

    def reset(self, env: VectorEnv) -> None:
        """Prepare for new episodes of `env`; raises InputError if the controller does not fit it."""
        ...

    def act(self, env: VectorEnv, observation: NDArray[np.float32]) -> Actions:
        """Return actions [envs, robots] for observations [envs, robots, size]."""
        ...


class RandomController:
    """Chooses every action with the same probability: the lower reference."""

    name = "random"

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._rngs: list[np.random.Generator] = []

    def reset(self, env: VectorEnv) -> None:
        # One generator an environment, so that a batch acts as its members would alone.
        self._rngs = [
            np.random.default_rng(np.random.SeedSequence((self._seed, seed, env.episode)))
            for seed in env.seeds
        ]

    def act(self, env: VectorEnv, observation: NDArray[np.float32]) -> Actions:
        return np.stack([rng.integers(0, env.num_actions, env.robots) for rng in self._rngs])
