"""Double DQN as an algorithm of the trainer: exploration, returns, and when to update."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robosim.errors import InputError, shown
from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.dqn.learner import DqnSettings, StackedDoubleDQN
from robosim.learning.algorithms.dqn.returns import MultiStepReturns, Transitions
from robosim.learning.algorithms.memory import ReplayMemory, decisions_taken, enough_memory
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
        self._members = members(config, task)
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
        networks, each = self._members.shape
        rows = np.repeat(epsilons, each, axis=0)
        chosen = self.learner.act(by_network(observation, self._members), rows)
        actions = np.empty((envs, robots), dtype=np.int64)
        actions[:, self._members.T] = chosen.reshape(envs, each, networks)
        return actions

    def observe(self, experience: Experience) -> None:
        self._decisions += len(experience.reward)
        complete = self._returns.add(experience)
        if complete is None:
            return
        if self.config.shares_parameters:
            complete = Transitions(*[by_network(part, self._members) for part in complete])
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
        self._decisions = decisions_taken(facts["decisions"], self.task)


def make_learner(config: DqnConfig, task: Task, seed: np.random.SeedSequence) -> StackedDoubleDQN:
    """Return fresh networks with their replay; InputError when it exceeds the memory."""
    # A shared network learns from as many transitions as its robots' own networks would together.
    networks, each = members(config, task).shape
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


def members(config: DqnConfig, task: Task) -> NDArray[np.int64]:
    """Return the robots that run each network, [networks, each]; InputError for groups of unequal size."""
    of_robot = np.array(config.network_of_robot(task))
    sizes = np.bincount(of_robot)
    if (sizes != sizes[0]).any():
        raise InputError(
            f'parameters is "group", but must be "own" or "shared" where groups have {shown(sizes.tolist())} '
            "robots: their networks learn side by side from as many each."
        )
    return np.argsort(of_robot, kind="stable").reshape(len(sizes), -1)


def by_network(array: NDArray[Any], robots: NDArray[np.int64]) -> NDArray[Any]:
    """Return [envs, robots, ...] as [envs * each, networks, ...]: robots of a network are its environments.

    `robots` are those of each network, [networks, each].
    """
    return np.ascontiguousarray(array[:, robots.T]).reshape(-1, len(robots), *array.shape[2:])
