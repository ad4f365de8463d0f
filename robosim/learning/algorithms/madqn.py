"""The joint-action learner (MA-DQN): one Double DQN for the whole team, which it takes for a single robot.

It sees the observations of all robots and has a value for each combination of their actions, of which there
are 5 ** robots. So it stops at eight robots, 390,625 combinations (`robosim.control.network.MOST_OUTPUTS`):
an update of eight costs hundreds of times one of three. docs/algorithms.md has the figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.network import MOST_OUTPUTS, NetworkSpec
from robosim.errors import InputError, shown
from robosim.learning.algorithms.dqn.algorithm import DoubleDqn
from robosim.learning.algorithms.dqn.config import DqnConfig, ReplayConfig
from robosim.learning.algorithms.protocol import Actors, Experience, State, Task


class MadqnConfig(ReplayConfig):
    """Joint-action Double DQN: one network chooses for all robots, and learns from their mean reward."""

    name: Literal["madqn"] = "madqn"
    """Of the algorithm."""

    @property
    def shares_parameters(self) -> bool:
        return True

    def starting_from(self, spec: NetworkSpec) -> Self:
        own = ("team", "relu", "none", "joint action values", self.hidden, False)
        theirs = (spec.input, spec.activation, spec.normalisation, spec.output, spec.hidden, spec.mask)
        if own != theirs:
            raise InputError(
                f"has a network of {shown(theirs)}, but must have one of {shown(own)} for the algorithm "
                '"madqn" (input, activation, normalisation, output, hidden, mask).'
            )
        return self

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> JointDqn:
        return JointDqn(self, task, seed, start)


class JointDqn:
    """A team that learns as one robot with the observations of all and every combination of their actions.

    It has a `LargeMemory`, the replay.
    """

    def __init__(
        self, config: MadqnConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """InputError when there are too many combinations, or too little memory."""
        combinations = task.num_actions**task.robots
        if combinations > MOST_OUTPUTS:
            raise InputError(
                f"robots is {task.robots}, but must be at most {_most_robots(task.num_actions)} for the "
                f'algorithm "madqn": its network has an output for each of the {task.num_actions} ** '
                f"{task.robots} combinations of the robots' actions."
            )
        self.task = task
        self._digits = (task.num_actions,) * task.robots
        team = Task(
            robots=1,
            num_envs=task.num_envs,
            names=task.names * task.robots,
            num_actions=combinations,
            actions=task.actions,
            decisions=task.decisions,
            explores=task.explores,
        )
        common = {name: getattr(config, name) for name in ReplayConfig.model_fields if name != "name"}
        self._team = DoubleDqn(DqnConfig(**common), team, seed, start)

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        combination = self._team.act(_as_one(observation), progress)[:, 0]
        return split_actions(combination, self._digits)

    def observe(self, experience: Experience) -> None:
        self._team.observe(
            experience._replace(
                observation=_as_one(experience.observation),
                action=combine_actions(experience.action, self._digits)[:, None],
                reward=experience.reward.mean(axis=1, keepdims=True),
                final_observation=_as_one(experience.final_observation),
                next_observation=_as_one(experience.next_observation),
            )
        )

    def update(self, progress: float) -> dict[str, float]:
        return self._team.update(progress)

    def actors(self) -> Actors:
        learner, task = self._team.learner, self.task
        spec = NetworkSpec(
            input="team",
            inputs=learner.shape.inputs,
            hidden=learner.shape.hidden,
            output="joint action values",
            actions=task.num_actions,
            of_robot=(0,) * task.robots,
        )
        return Actors(spec, learner.parameters.to_numpy())

    def state(self) -> State:
        return self._team.state()

    def restore(self, state: State) -> None:
        self._team.restore(state)

    def held(self) -> tuple[int, int]:
        return self._team.held()

    def export(self, first: int, last: int) -> dict[str, Tensor]:
        return self._team.export(first, last)

    def recall(self, first: int, parts: Iterable[Mapping[str, Tensor]]) -> None:
        self._team.recall(first, parts)


def combine_actions(actions: NDArray[np.int64], digits: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the number [...] of each combination of actions [..., robots], robot 0's the first digit."""
    return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(actions, -1, 0)), digits), np.int64)


def split_actions(combination: NDArray[np.int64], digits: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the actions [..., robots] of which `combine_actions` makes `combination` [...]."""
    return np.stack(np.unravel_index(combination, digits), axis=-1)


def _as_one(observation: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return [envs, robots, size] as [envs, 1, robots * size]."""
    return observation.reshape(len(observation), 1, -1)


def _most_robots(num_actions: int) -> int:
    return int(np.log(MOST_OUTPUTS) / np.log(num_actions))
