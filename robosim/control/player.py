"""A policy at work, from one decision to the next."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robosim.control.network import NetworkSpec


class Player:
    """Lets a policy act, and remembers which robots retreat, if they do."""

    def __init__(self, act: Callable[..., NDArray[np.int64]], spec: NetworkSpec) -> None:
        """Take the method `act` of whatever runs the networks `spec`."""
        self._act = act
        self._remembers = spec.retreat_in_place is not None
        self._retreats = np.zeros(0, np.int64)

    def act(self, observation: NDArray[np.float32], decision: int) -> NDArray[np.int64]:
        """Return the actions [..., robots] for `observation` [..., robots, size].

        `decision` is its number since the episode began; in decision 0, and when robots or environments are
        other ones, nobody retreats yet.
        """
        if not self._remembers:
            return self._act(observation, decision)
        shape = observation.shape[:-1]
        if decision == 0 or self._retreats.shape != shape:
            self._retreats = np.zeros(shape, np.int64)
        return self._act(observation, decision, self._retreats)
