"""Returns over several decisions, so that a reward reaches the decisions before it at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.learning.algorithms.protocol import Experience


class Transitions(NamedTuple):
    """Decisions of every robot with their returns, and what followed; one a row, of whichever environment."""

    observation: NDArray[np.float32]
    """[rows, robots, size]."""
    action: NDArray[np.int64]
    """[rows, robots]."""
    reward: NDArray[np.float32]
    """[rows, robots] discounted sum over the decisions up to `successor`."""
    successor: NDArray[np.float32]
    """[rows, robots, size] what followed the last of them."""
    continues: NDArray[np.float32]
    """[rows, robots] 1 where the value of the successor counts, 0 where the task ended with it."""


class MultiStepReturns:
    """Turns single decisions into transitions that span `steps` of them (Sutton 1988).

    Environments may end their episodes at different times. Where one is cut off, its last decisions, which
    have fewer after them, are left out, so that all transitions that go on do so with discount ** steps.
    Where the task ends, they are kept: nothing follows that could be missed.
    """

    def __init__(self, steps: int, discount: float) -> None:
        self._steps = steps
        self._discount = np.float32(discount)
        self._open: deque[tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]] = deque(
            maxlen=steps
        )
        """The latest decisions, at most `steps`."""
        self._age = np.zeros(0, dtype=np.int64)
        """[envs] how many of them belong to the present episode and are not complete yet."""

    def add(self, decision: Experience) -> Transitions | None:
        """Take in one decision of every environment; return the transitions it completes, oldest first."""
        if not len(self._age):
            self._age = np.zeros(len(decision.reward), dtype=np.int64)
        self._open.append((decision.observation, decision.action, decision.reward))
        self._age += 1
        complete: list[Transitions] = []
        total = decision.reward
        for back, (observation, action, reward) in enumerate(reversed(self._open), start=1):
            if back > 1:
                total = reward + self._discount * total
            ready = (self._age >= back) & (decision.terminated | (back == self._steps))
            if not ready.any():
                continue
            rows = np.s_[:] if ready.all() else ready
            continues = np.repeat(~decision.terminated[rows, None], reward.shape[1], axis=1)
            complete.insert(
                0,
                Transitions(
                    observation[rows],
                    action[rows],
                    total[rows],
                    decision.final_observation[rows],
                    continues.astype(np.float32),
                ),
            )
        self._age[self._age == self._steps] -= 1
        self._age[decision.ended] = 0
        if not complete:
            return None
        if len(complete) == 1:
            return complete[0]
        return Transitions(*map(np.concatenate, zip(*complete, strict=True)))

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the decisions that are not complete yet, stacked; nothing where there are none."""
        if not self._open:
            return {}
        names = ("observation", "action", "reward")
        stacked = {
            name: np.stack(part) for name, part in zip(names, zip(*self._open, strict=True), strict=True)
        }
        return stacked | {"age": self._age.copy()}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take back what `state` returned."""
        self._open.clear()
        self._age = np.zeros(0, dtype=np.int64)
        if state:
            self._open.extend(zip(state["observation"], state["action"], state["reward"], strict=True))
            self._age = state["age"].copy()
