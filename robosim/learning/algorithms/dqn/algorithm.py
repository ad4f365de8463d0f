"""Double DQN as an algorithm of the trainer: exploration, returns, and when to update."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.dqn.learner import DqnSettings, StackedDoubleDQN
from robosim.learning.algorithms.dqn.returns import MultiStepReturns, Transitions
from robosim.learning.algorithms.memory import ReplayMemory, enough_memory
from robosim.learning.algorithms.protocol import Actors, Experience, State, Task
from robosim.learning.algorithms.stacked import part, prefixed
from robosim.learning.networks import NetworkShape


class DoubleDqn(ReplayMemory):
    """Robots that learn by Double DQN, each its own network or all one; has a `LargeMemory`, its replay."""

    def __init__(
        self, config: DqnConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """Reserve the replay; InputError when it exceeds the memory, or `start` does not fit."""
        self.config = config
        self.task = task
        self.learner = make_learner(config, task, seed)
        self.replay = self.learner.replay
        if start is not None:
            self.learner.load_parameters(start.weights)
        self._returns = MultiStepReturns(config.return_steps, config.discount)
        self._decisions = 0
        """Joint decisions observed."""

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        envs, robots = observation.shape[:2]
        epsilons = self.config.epsilons_in(self.task, progress, envs)
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
        self.replay.add(*complete)

    def update(self, progress: float) -> dict[str, float]:
        config, learner = self.config, self.learner
        rate = config.learning_rate_at(progress)
        due = config.updates_due(self._decisions)
        while self.replay.length and learner.updates < due:
            learner.update(rate)
        return {
            "epsilon": self.config.epsilon_in(self.task, progress),
            "learning_rate": rate,
            "loss": float(learner.loss().mean()),
        }

    def actors(self) -> Actors:
        return Actors(self.config.value_networks(self.task), self.learner.parameters.to_numpy())

    def state(self) -> State:
        arrays = self._returns.state().items()
        tensors = prefixed("learner.", self.learner.state())
        tensors |= prefixed("open.", {name: torch.from_numpy(array) for name, array in arrays})
        return State(tensors, {"decisions": self._decisions, "learner": self.learner.counters()})

    def restore(self, state: State) -> None:
        tensors, facts = state
        self.learner.restore(part(tensors, "learner."), facts["learner"])
        self._returns.restore({name: tensor.numpy() for name, tensor in part(tensors, "open.").items()})
        self._decisions = int(facts["decisions"])


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
    with enough_memory(config, task):
        return StackedDoubleDQN(shape, settings, seed, config.device, config.precision)


def as_one_robot(array: NDArray[Any]) -> NDArray[Any]:
    """Return [envs, robots, ...] as [envs * robots, 1, ...]: one network takes robots for environments."""
    return np.ascontiguousarray(array).reshape(-1, 1, *array.shape[2:])
