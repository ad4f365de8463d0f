"""Returns over several decisions, so that a reward reaches the decisions before it at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Experience(NamedTuple):
    """A decision of every robot in every environment, and what came of it."""

    observation: NDArray[np.float32]
    """[envs, robots, size]."""
    action: NDArray[np.int64]
    """[envs, robots]."""
    reward: NDArray[np.float32]
    """[envs, robots] discounted sum over the decisions up to `successor`."""
    successor: NDArray[np.float32]
    """[envs, robots, size] what followed the last of them."""


class MultiStepReturns:
    """Turns single decisions into experiences that span `steps` of them (Sutton 1988).

    The last decisions of an episode, which have fewer after them, are left out, so that all experiences
    bootstrap with the same discount ** steps.
    """

    def __init__(self, steps: int, discount: float) -> None:
        self._steps = steps
        self._discount = np.float32(discount)
        self._open: deque[tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]] = deque()

    def add(self, decision: Experience, ended: bool) -> Experience | None:
        """Take in one decision, `ended` if its episode ends with it; return the experience it completes."""
        self._open.append(decision[:3])
        if len(self._open) < self._steps:
            complete = None
        else:
            total = decision.reward
            for _, _, reward in list(self._open)[-2::-1]:
                total = reward + self._discount * total
            observation, action, _ = self._open.popleft()
            complete = Experience(observation, action, total, decision.successor)
        if ended:
            self._open.clear()
        return complete

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the decisions that are not complete yet, stacked; nothing where there are none."""
        if not self._open:
            return {}
        names = ("observation", "action", "reward")
        return {name: np.stack(part) for name, part in zip(names, zip(*self._open, strict=True), strict=True)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take back what `state` returned."""
        self._open.clear()
        if state:
            self._open.extend(zip(state["observation"], state["action"], state["reward"], strict=True))
