"""What algorithms that learn action values have in common: settings, and exploration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from robosim.control.network import NetworkSpec
from robosim.discretise.observation import MoveGains, mask_blocked_moves
from robosim.errors import InputError, shown
from robosim.learning.algorithms.protocol import Task
from robosim.learning.algorithms.settings import LearnerConfig, MaskConfig


class ValueConfig(LearnerConfig):
    """Base of the configurations of algorithms that learn action values and explore by random actions."""

    epsilon_start: float = Field(default=1.0, ge=0, le=1)
    """Share of random actions at the start."""
    epsilon_end: float = Field(default=0.02, ge=0, le=1)
    """Share of random actions once exploration has run down."""
    epsilon_spread: float = Field(default=7.0, ge=0, le=1000)
    """How much less further environments explore: the i-th of n by epsilon ** (1 + spread * i / (n - 1))."""
    exploration: float = Field(default=0.1, ge=0, le=1)
    """Share of a stage over which the share of random actions falls."""

    @model_validator(mode="after")
    def _check_epsilon(self) -> Self:
        if self.epsilon_end > self.epsilon_start:
            raise ValueError(
                f"epsilon_end is {self.epsilon_end}, but must be a number of at most epsilon_start, "
                f"{self.epsilon_start}"
            )
        return self

    def epsilon(self, progress: float) -> float:
        """Return the share of random actions at `progress` (0 to 1) of a stage; it falls, then stays."""
        explored = 1.0 if self.exploration == 0.0 else min(1.0, progress / self.exploration)
        return self.epsilon_start + (self.epsilon_end - self.epsilon_start) * explored

    def epsilon_in(self, task: Task, progress: float) -> float:
        """Return the share of random actions at `progress` of a stage that may not explore anew."""
        return self.epsilon(progress) if task.explores else self.epsilon_end

    def epsilons(self, epsilon: float, num_envs: int) -> NDArray[np.float64]:
        """Return the share of random actions in each environment, [envs], from that of the first.

        All but the first soon act almost greedily (Horgan 2018), so that experience holds what the finished
        team would do, standstill included.
        """
        place = np.arange(num_envs) / max(1, num_envs - 1)
        return np.asarray(epsilon ** (1.0 + self.epsilon_spread * place))

    def epsilons_in(self, task: Task, progress: float, num_envs: int) -> NDArray[np.float64]:
        """Return the share of random actions in each environment at `progress` of a stage, [envs, 1]."""
        return self.epsilons(self.epsilon_in(task, progress), num_envs)[:, None]

    def require_action_values(self, spec: NetworkSpec) -> None:
        """Raise InputError, a sentence that begins with "has", unless `spec` maps own observations to values.

        Its hidden layers and their normalisation must be some that the algorithm has, too.
        """
        if (spec.input, spec.activation, spec.output) != ("own", "relu", "action values"):
            raise InputError(
                f"has networks from {spec.input} observations to {spec.output} by {spec.activation}, but "
                f"must have ones from own observations to action values by relu for the algorithm "
                f"{shown(self.name)}."
            )
        if spec.hidden != self.hidden:
            raise InputError(
                f"has hidden layers {shown(spec.hidden)}, but must have {shown(self.hidden)}, as hidden says."
            )
        if self.shares_parameters and spec.networks > 1:
            raise InputError(
                'has a network for each robot, but must have one for all where parameters is "shared".'
            )
        field = type(self).model_fields.get("normalisation")
        kinds = get_args(field.annotation) if field else ("none",)
        if spec.normalisation not in kinds:
            raise InputError(
                f"has layers with normalisation {shown(spec.normalisation)}, but must have "
                f"{' or '.join(map(shown, kinds))} for the algorithm {shown(self.name)}."
            )


class OwnValuesConfig(MaskConfig, ValueConfig):
    """Base of those whose robots act each by the values of its own observation."""

    parameters: Literal["own", "shared"] = "own"
    """Each robot has a network of its own, or all act by one, which learns from what each of them does
    (Gupta 2017)."""
    normalisation: Literal["none", "rms", "layer"] = "none"
    """`layer`: hidden layers are brought to mean 0 and variance 1 before ReLU; `rms`: they are divided by
    their root mean square after it."""

    @property
    def shares_parameters(self) -> bool:
        return self.parameters == "shared"

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration with the layers and the mask of `spec`.

        Networks that learned with normalised layers or behind a mask know nothing of acting without.
        """
        self.require_action_values(spec)
        return self.changed(normalisation=spec.normalisation, mask=spec.mask)

    def value_networks(self, task: Task) -> NetworkSpec:
        """Return what the robots' networks are."""
        return self.own_networks(task, "action values").changed(normalisation=self.normalisation)


def epsilon_greedy(
    rng: np.random.Generator,
    values: Callable[[NDArray[np.float32]], NDArray[np.float32]],
    observation: NDArray[np.float32],
    epsilon: float | NDArray[np.float64],
    num_actions: int,
    gains: MoveGains | None,
) -> NDArray[np.int64]:
    """Choose actions [envs, robots]: each robot its best that is open, or with probability `epsilon` any.

    `values` gives those of the actions, [envs, robots, actions], for `observation` [envs, robots, size];
    `epsilon` is one number, or [envs, 1]; `gains` is where observations hold the gains of moves
    (`gain_columns`), of which blocked ones are never the best, None for no mask.
    """
    shape = observation.shape[:2]
    # Both draws are always made, so that the stream of numbers does not depend on the outcome.
    explores = rng.random(shape) < epsilon
    drawn = rng.integers(num_actions, size=shape)
    if explores.all():
        return drawn
    best = mask_blocked_moves(values(observation), observation, gains).argmax(axis=-1)
    return np.where(explores, drawn, best)
