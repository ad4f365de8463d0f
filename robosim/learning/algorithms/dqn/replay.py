"""Experience replay: each robot keeps and samples its own transitions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.errors import InputError
from robosim.learning.networks import CPU


class Batch:
    """Transitions of some robots, drawn from the replay into memory reserved once."""

    def __init__(self, pairs: Tensor, numbers: Tensor, actions: Tensor) -> None:
        self.pairs = pairs
        """[2, robots, transitions, size]: observations, and what followed each."""
        self.numbers = numbers
        """[robots, transitions, 3]: action, reward, and whether the task went on."""
        self.observations, self.successors = pairs
        """[robots, transitions, size] each."""
        self.actions = actions
        """[robots, transitions, 1], int64."""
        self.rewards = numbers[..., 1:2]
        """[robots, transitions, 1]."""
        self.continues = numbers[..., 2:3]
        """[robots, transitions, 1]: 1, or 0 where the task ended with the successor."""

    @classmethod
    def reserve(cls, robots: int, transitions: int, size: int, device: torch.device = CPU) -> Batch:
        """Return memory for so many transitions of each robot, with observations of `size` numbers."""
        return cls(
            torch.zeros(2, robots, transitions, size, device=device),
            torch.zeros(robots, transitions, 3, device=device),
            torch.zeros(robots, transitions, 1, dtype=torch.int64, device=device),
        )

    def part(self, robots: slice) -> Batch:
        """Return views of what belongs to those robots."""
        return Batch(self.pairs[:, robots], self.numbers[robots], self.actions[robots])


class Replay:
    """Ring of the latest `capacity` transitions of every robot.

    It takes `robots * capacity * (8 * size + 12)` bytes, reserved at once and touched as it fills.
    """

    def __init__(self, robots: int, capacity: int, size: int, device: torch.device = CPU) -> None:
        self.capacity = capacity
        self.added = 0
        """Transitions ever added of each robot; number k lies at place k % capacity."""
        # An observation and its successor lie side by side, and so do the numbers: a transition is fetched
        # from two places of the memory, not five.
        self._pairs = _reserve((robots, capacity, 2, size), device)
        self._numbers = _reserve((robots, capacity, 3), device)
        self._first_rows = capacity * np.arange(robots)[:, None]

    @property
    def length(self) -> int:
        """Transitions held of each robot."""
        return min(self.added, self.capacity)

    def add(
        self,
        observations: NDArray[np.float32],
        actions: NDArray[np.int64],
        rewards: NDArray[np.float32],
        successors: NDArray[np.float32],
        continues: NDArray[np.float32] | None = None,
    ) -> None:
        """Store some transitions of every robot.

        `observations` and `successors` are [rows, robots, size], the others [rows, robots]; `continues` is 0
        where the task ended with the successor, 1 elsewhere, and 1 everywhere where it is not given.
        """
        pairs = np.stack((observations, successors), axis=2)
        goes_on = np.ones_like(rewards) if continues is None else continues
        numbers = np.stack((actions, rewards, goes_on), axis=2, dtype=np.float32, casting="same_kind")
        self._store(torch.from_numpy(pairs).transpose(0, 1), torch.from_numpy(numbers).transpose(0, 1))

    def sample(self, rng: np.random.Generator, batch: Batch, together: bool = False) -> None:
        """Fill `batch` with transitions of each robot, drawn uniformly, independently, with replacement.

        With `together` the draw is one for all robots, so that the i-th of each are of the same decision.
        ValueError while there are none.
        """
        if not self.added:
            raise ValueError("the replay is empty")
        # `Generator.integers` takes twice as long for so few numbers.
        robots, transitions = batch.rewards.shape[:2]
        places = (rng.random((1 if together else robots, transitions)) * self.length).astype(np.int64)
        rows = (places + self._first_rows).ravel()
        in_pairs = np.concatenate((2 * rows, 2 * rows + 1))
        device = self._pairs.device
        for table, chosen, into in (
            (self._pairs.flatten(0, 2), in_pairs, batch.pairs.flatten(0, 2)),
            (self._numbers.flatten(0, 1), rows, batch.numbers.flatten(0, 1)),
        ):
            torch.index_select(table, 0, torch.from_numpy(chosen).to(device), out=into)
        batch.actions.copy_(batch.numbers[..., :1])

    def export(self, first: int, last: int) -> dict[str, Tensor]:
        """Return copies, on the CPU, of the transitions number `first` to `last - 1`.

        `observations` and `successors` are [robots, transitions, size], `actions`, `rewards` and
        `continues` [robots, transitions]. ValueError unless the replay still holds them all.
        """
        oldest = self.added - self.length
        if not oldest <= first <= last <= self.added:
            raise ValueError(
                f"transitions {first} to {last} are asked for; held are {oldest} to {self.added}"
            )
        places = torch.arange(first, last, device=self._pairs.device) % self.capacity
        pairs, numbers = self._pairs[:, places].cpu(), self._numbers[:, places].cpu()
        return {
            "observations": pairs[:, :, 0].contiguous(),
            "successors": pairs[:, :, 1].contiguous(),
            "actions": numbers[..., 0].long(),
            "rewards": numbers[..., 1].contiguous(),
            "continues": numbers[..., 2].contiguous(),
        }

    @property
    def most_bytes(self) -> int:
        """The size of what `export` returns of a full replay."""
        robots, capacity = self._numbers.shape[:2]
        # Actions are whole numbers there.
        return self._pairs.nbytes + self._numbers.nbytes + 8 * robots * capacity

    def restore(self, first: int, parts: Iterable[Mapping[str, Tensor]]) -> None:
        """Take back what `export` returned: transitions number `first` and on, in parts one after another.

        Afterwards the replay samples as the one that they came from. What has been overwritten since may
        be left out. InputError when a part does not fit this replay, or the parts hold too little.
        """
        robots, _, _, size = self._pairs.shape
        self.added = first
        for part in parts:
            shapes = {name: tuple(tensor.shape) for name, tensor in part.items()}
            count = (*shapes.get("rewards", ()), 0, 0)[1]
            each = (robots, count)
            pair = (*each, size)
            fits: dict[str, tuple[int, ...]] = {"observations": pair, "successors": pair}
            fits |= dict.fromkeys(("actions", "rewards", "continues"), each)
            if shapes != fits:
                raise InputError(f"the replay's transitions have the shapes {shapes}: they must be {fits}.")
            pairs = torch.stack((part["observations"], part["successors"]), dim=2)
            numbers = torch.stack((part["actions"].float(), part["rewards"], part["continues"]), dim=2)
            self._store(pairs, numbers)
        oldest = self.added - self.length
        if first > oldest:
            raise InputError(f"the replay's transitions start at number {first}: {oldest} is needed.")

    def _store(self, pairs: Tensor, numbers: Tensor) -> None:
        """Write transitions [robots, count, 2, size] and [robots, count, 3] behind the latest."""
        count = numbers.shape[1]
        done = max(0, count - self.capacity)
        while done < count:
            place = (self.added + done) % self.capacity
            run = min(count - done, self.capacity - place)
            self._pairs[:, place : place + run] = pairs[:, done : done + run]
            self._numbers[:, place : place + run] = numbers[:, done : done + run]
            done += run
        self.added += count


def _reserve(shape: tuple[int, ...], device: torch.device) -> Tensor:
    if device != CPU:
        return torch.empty(shape, device=device)
    # NumPy asks for huge pages; without them, half the time of drawing goes into finding the pages.
    return torch.from_numpy(np.empty(shape, np.float32))
