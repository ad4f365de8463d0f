"""A joint-action advantage actor-critic (MA-A2C): one actor and one critic for the whole team.

The actor sees the observations of all robots and chooses among all combinations of their actions; it learns
from the team's mean reward. There are actions ** robots combinations, so it is for small teams.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.network import NetworkSpec, blocked_combinations
from robosim.discretise.observation import blocked_moves
from robosim.errors import InputError
from robosim.learning.algorithms.actor_critic import NEVER, ActorCriticConfig, AdvantageActorCritic, Floats
from robosim.learning.algorithms.joint import as_one, experience_as_one, most_robots, split_actions
from robosim.learning.algorithms.protocol import Actors, Experience, Task


class MaA2cConfig(ActorCriticConfig):
    """Joint-action advantage actor-critic."""

    actor_kind = ("team", "joint logits")

    name: Literal["maa2c"] = "maa2c"
    """Of the algorithm."""

    @property
    def shares_parameters(self) -> bool:
        return True

    @property
    def needs_team(self) -> bool:
        return True

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> MaA2c:
        return MaA2c(self, task, seed, start)


class MaA2c(AdvantageActorCritic):
    """The team as a single robot: it sees what all see, and its actions are the combinations of theirs."""

    def __init__(
        self, config: MaA2cConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """`start` gives the actor; the critic always begins anew."""
        _require_few(task)
        spec = NetworkSpec(
            input="team",
            inputs=task.robots * task.size,
            hidden=config.hidden,
            activation=config.activation,
            mask=config.mask and task.gains is not None,
            output="joint logits",
            actions=task.num_actions,
            of_robot=(0,) * task.robots,
        )
        super().__init__(config, task, seed, start, spec)
        self._digits = (task.num_actions,) * task.robots

    def act(self, observation: Floats, progress: float) -> NDArray[np.int64]:
        return split_actions(super().act(as_one(observation), progress)[:, 0], self._digits)

    def observe(self, experience: Experience) -> None:
        super().observe(experience_as_one(experience, self._digits))

    def _masked(self, logits: Tensor, observation: Tensor) -> Tensor:
        if self._gains is None:
            return logits
        each = observation.reshape(*observation.shape[:-1], self.task.robots, self.task.size)
        blocked = blocked_combinations(blocked_moves(each, self._gains).numpy(), self.task.num_actions)
        return logits.masked_fill(torch.from_numpy(blocked), NEVER)


def _require_few(task: Task) -> None:
    most = most_robots(task.num_actions)
    if task.robots > most:
        raise InputError(
            f'robots is {task.robots}, but must be at most {most} for the algorithm "maa2c": one actor for '
            f"all has an output for each combination of their {task.num_actions} actions, "
            f"{task.num_actions**task.robots} of them."
        )
