"""The joint-action learner (MA-DQN): one Double DQN for the whole team, which it takes for a single robot.

It sees the observations of all robots and has a value for each combination of their actions, of which there
are 5 ** robots. So it stops at eight robots, 390,625 combinations (`robosim.control.network.MOST_OUTPUTS`):
an update of eight costs hundreds of times one of three. docs/algorithms.md has the figures.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from robosim.control.network import NetworkSpec
from robosim.errors import InputError, shown
from robosim.learning.algorithms.dqn.algorithm import DoubleDqn
from robosim.learning.algorithms.dqn.config import DoubleQConfig, DqnConfig
from robosim.learning.algorithms.joint import as_one, experience_as_one, most_robots, split_actions
from robosim.learning.algorithms.protocol import Actors, Experience, Task


class MadqnConfig(DoubleQConfig):
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

    @property
    def needs_team(self) -> bool:
        return True

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> JointDqn:
        return JointDqn(self, task, seed, start)


class JointDqn(DoubleDqn):
    """A team that learns as one robot with the observations of all and every combination of their actions."""

    def __init__(
        self, config: MadqnConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """InputError when there are too many combinations, or too little memory."""
        most = most_robots(task.num_actions)
        if task.robots > most:
            raise InputError(
                f"robots is {task.robots}, but must be at most {most} for the "
                f'algorithm "madqn": its network has an output for each of the {task.num_actions} ** '
                f"{task.robots} combinations of the robots' actions."
            )
        self._digits = (task.num_actions,) * task.robots
        combinations = task.num_actions**task.robots
        team = replace(task, robots=1, names=task.names * task.robots, num_actions=combinations)
        common = {name: getattr(config, name) for name in DoubleQConfig.model_fields if name != "name"}
        super().__init__(DqnConfig(**common), team, seed, start)

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        combination = super().act(as_one(observation), progress)[:, 0]
        return split_actions(combination, self._digits)

    def observe(self, experience: Experience) -> None:
        super().observe(experience_as_one(experience, self._digits))

    def actors(self) -> Actors:
        actions, *_ = self._digits
        spec = NetworkSpec(
            input="team",
            inputs=self.task.size,
            hidden=self.config.hidden,
            output="joint action values",
            actions=actions,
            of_robot=(0,) * len(self._digits),
        )
        return Actors(spec, self.learner.parameters.to_numpy())
