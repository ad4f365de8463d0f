"""Double DQN as an algorithm of the trainer: exploration, returns, and when to update."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.network import NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.dqn.learner import DqnSettings, StackedDoubleDQN
from robosim.learning.algorithms.dqn.returns import MultiStepReturns, Transitions
from robosim.learning.algorithms.protocol import Actors, Experience, State, Task
from robosim.learning.networks import NetworkShape


class DoubleDqn:
    """Robots that learn by Double DQN, each its own network or all one; has a `LargeMemory`, its replay."""

    def __init__(
        self, config: DqnConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """Reserve the replay; InputError when it exceeds the memory, or `start` does not fit."""
        self.config = config
        self.task = task
        self.learner = make_learner(config, task, seed)
        if start is not None:
            self.learner.load_parameters(start.weights)
        self._returns = MultiStepReturns(config.return_steps, config.discount)
        self._decisions = 0
        """Joint decisions observed."""

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        envs, robots = observation.shape[:2]
        epsilons = self.config.epsilons(self._epsilon(progress), envs)[:, None]
        if not self.config.shares_parameters:
            return self.learner.act(observation, epsilons)
        each = np.repeat(epsilons, robots, axis=0)
        return self.learner.act(as_one_robot(observation), each).reshape(envs, robots)

    def observe(self, experience: Experience) -> None:
        self._decisions += len(experience.reward)
        complete = self._returns.add(experience)
        if complete is None:
            return
        if self.config.shares_parameters:
            complete = Transitions(*[as_one_robot(part) for part in complete])
        self.learner.replay.add(*complete)

    def update(self, progress: float) -> dict[str, float]:
        config, learner = self.config, self.learner
        rate = config.learning_rate_at(progress)
        due = config.updates_due(self._decisions)
        while learner.replay.length and learner.updates < due:
            learner.update(rate)
        return {
            "epsilon": self._epsilon(progress),
            "learning_rate": rate,
            "loss": float(learner.loss().mean()),
        }

    def actors(self) -> Actors:
        config, task, shape = self.config, self.task, self.learner.shape
        spec = NetworkSpec(
            inputs=shape.inputs,
            hidden=shape.hidden,
            normalisation=config.normalisation,
            mask=self.learner.settings.gains is not None,
            output="action values",
            actions=shape.outputs,
            of_robot=(0,) * task.robots if config.shares_parameters else tuple(range(task.robots)),
        )
        return Actors(spec, self.learner.parameters.to_numpy())

    def state(self) -> State:
        tensors = {f"learner.{name}": tensor for name, tensor in self.learner.state().items()}
        tensors |= {f"open.{name}": torch.from_numpy(a) for name, a in self._returns.state().items()}
        return State(tensors, {"decisions": self._decisions, "learner": self.learner.counters()})

    def restore(self, state: State) -> None:
        tensors, facts = state
        self.learner.restore(_part(tensors, "learner."), facts["learner"])
        self._returns.restore({name: tensor.numpy() for name, tensor in _part(tensors, "open.").items()})
        self._decisions = int(facts["decisions"])

    def held(self) -> tuple[int, int]:
        replay = self.learner.replay
        return replay.added - replay.length, replay.added

    def export(self, first: int, last: int) -> dict[str, Tensor]:
        return self.learner.replay.export(first, last)

    def recall(self, first: int, parts: Iterable[Mapping[str, Tensor]]) -> None:
        self.learner.replay.restore(first, parts)

    def _epsilon(self, progress: float) -> float:
        return self.config.epsilon(progress) if self.task.explores else self.config.epsilon_end


def make_learner(config: DqnConfig, task: Task, seed: np.random.SeedSequence) -> StackedDoubleDQN:
    """Return fresh networks with their replay; InputError when it exceeds the memory."""
    # One network for all learns from as many transitions as their own networks would together.
    networks, each = (1, task.robots) if config.shares_parameters else (task.robots, 1)
    shape = NetworkShape(
        networks, task.size, config.hidden, task.num_actions, normalised=config.normalisation == "rms"
    )
    settings = DqnSettings(
        discount=config.discount**config.return_steps,
        batch_size=config.batch_size * each,
        target_interval=config.target_interval,
        replay_capacity=config.capacity(task) * each,
        reward_scale=config.reward_scale,
        gains=task.gains if config.mask else None,
    )
    try:
        return StackedDoubleDQN(shape, settings, seed, config.device, config.precision)
    except (RuntimeError, MemoryError) as error:
        raise InputError(
            f"replay_capacity is {config.replay_capacity}, but must be less: {task.robots} robots with "
            f"observations of {task.size} numbers need more memory than there is."
        ) from error


def as_one_robot(array: NDArray[Any]) -> NDArray[Any]:
    """Return [envs, robots, ...] as [envs * robots, 1, ...]: one network takes robots for environments."""
    return np.ascontiguousarray(array).reshape(-1, 1, *array.shape[2:])


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): one for name, one in tensors.items() if name.startswith(prefix)}
