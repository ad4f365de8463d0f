"""Controllers: whatever chooses actions for a whole team, scripted or learned."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from robosim.control.lanes import LanesController
from robosim.control.learned import LearnedController
from robosim.control.policy import find_policy, read_policy
from robosim.control.protocols import ActiveController, LorenzController, ReversalController
from robosim.control.seek import require_world
from robosim.errors import name_or_path as text_of

if TYPE_CHECKING:
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
        require_world(self.name, env)
        # One generator an environment, so that a batch acts as its members would alone.
        self._rngs = [
            np.random.default_rng(np.random.SeedSequence((self._seed, seed, env.episode)))
            for seed in env.seeds
        ]

    def act(self, env: VectorEnv, observation: NDArray[np.float32]) -> Actions:
        return np.stack([rng.integers(0, env.num_actions, env.robots) for rng in self._rngs])


SCRIPTED: dict[str, Callable[[], Controller]] = {
    "lanes": LanesController,
    "active": ActiveController,
    "reversal": ReversalController,
    "lorenz": LorenzController,
    "random": RandomController,
}
"""Scripted controllers by name."""


def register_controller(name: str, make: Callable[[], Controller]) -> None:
    """Make a scripted controller known by a name, in the place of any that had it.

    `make` returns a new one.
    """
    SCRIPTED[name] = make


def make_controller(name_or_path: str | Path) -> Controller:
    """Return a scripted controller by name, else a policy that ships by name, else one by its folder.

    InputError for a name that nobody knows, with the nearest ones, and for an unsound policy.
    """
    text = text_of("controller", name_or_path)
    if text in SCRIPTED:
        return SCRIPTED[text]()
    return LearnedController(read_policy(find_policy(name_or_path, SCRIPTED)), text)
