"""The replay as an algorithm's memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from robosim.control.card import MOST
from robosim.errors import InputError, whole_number
from robosim.learning.algorithms.dqn.replay import Batch, Replay
from robosim.learning.algorithms.dqn.returns import MultiStepReturns
from robosim.learning.algorithms.protocol import Experience, State, Task
from robosim.learning.algorithms.settings import ReplayConfig
from robosim.learning.algorithms.stacked import part, prefixed
from robosim.learning.networks import CPU


class ReplayMemory:
    """An algorithm whose replay is its `LargeMemory`."""

    replay: Replay

    def held(self) -> tuple[int, int]:
        return self.replay.added - self.replay.length, self.replay.added

    def export(self, first: int, last: int) -> dict[str, Tensor]:
        return self.replay.export(first, last)

    def most_bytes(self) -> int:
        return self.replay.most_bytes

    def recall(self, first: int, parts: Iterable[Mapping[str, Tensor]]) -> None:
        self.replay.restore(first, parts)


class JointReplay(ReplayMemory):
    """An algorithm whose robots learn from the same moments, for what each does concerns the others."""

    def __init__(
        self,
        config: ReplayConfig,
        task: Task,
        choose: np.random.SeedSequence,
        draw: np.random.SeedSequence,
        device: torch.device = CPU,
    ) -> None:
        """`choose` is for actions, `draw` for batches. InputError when the replay exceeds the memory."""
        self.task, self._settings = task, config
        with enough_memory(config, task):
            self.replay = Replay(task.robots, config.capacity(task), task.size, device)
        self._batch = Batch.reserve(task.robots, config.batch_size, task.size, device)
        self._returns = MultiStepReturns(config.return_steps, config.discount)
        self._choose, self._draw = np.random.default_rng(choose), np.random.default_rng(draw)
        self._decisions = 0
        """Joint decisions observed."""
        self.updates = 0

    def observe(self, experience: Experience) -> None:
        self._decisions += len(experience.reward)
        complete = self._returns.add(experience)
        if complete is not None:
            self.replay.add(*complete)

    def state(self) -> State:
        arrays = self._returns.state().items()
        facts = {
            "decisions": self._decisions,
            "updates": self.updates,
            "choose": self._choose.bit_generator.state,
            "draw": self._draw.bit_generator.state,
        }
        return State(prefixed("open.", {name: torch.from_numpy(array) for name, array in arrays}), facts)

    def restore(self, state: State) -> None:
        tensors, facts = state
        self._returns.restore({name: tensor.numpy() for name, tensor in part(tensors, "open.").items()})
        self._decisions = decisions_taken(facts["decisions"], self.task)
        self.updates = whole_number("updates", facts["updates"], 0, MOST)
        self._choose.bit_generator.state = facts["choose"]
        self._draw.bit_generator.state = facts["draw"]

    def _is_due(self) -> bool:
        """Return whether there is an update to make."""
        return self.replay.length > 0 and self.updates < self._settings.updates_due(self._decisions)

    def _next_batch(self) -> Batch:
        """Return the batch of the next update."""
        self.replay.sample(self._draw, self._batch, together=True)
        self.updates += 1
        return self._batch


def decisions_taken(number: object, task: Task) -> int:
    """Return how many joint decisions a checkpoint says were observed; InputError for more than there are.

    So many updates are due, which would be made up for without end.
    """
    return whole_number("decisions", number, 0, task.decisions + task.num_envs)


@contextmanager
def enough_memory(config: ReplayConfig, task: Task) -> Iterator[None]:
    """Raise InputError where reserving a replay fails."""
    try:
        yield
    except (RuntimeError, MemoryError) as error:
        raise InputError(
            f"replay_capacity is {config.replay_capacity}, but must be less: {task.robots} robots with "
            f"observations of {task.size} numbers need more memory than there is."
        ) from error
