"""The configuration of Double DQN."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from robosim.control.network import NetworkSpec
from robosim.errors import InputError, shown
from robosim.learning.algorithms.protocol import Actors, AlgorithmConfig, Task
from robosim.records import Many

if TYPE_CHECKING:
    from robosim.learning.algorithms.dqn.algorithm import DoubleDqn


class DqnConfig(AlgorithmConfig):
    """Double DQN with experience replay (van Hasselt 2016)."""

    name: Literal["dqn"] = "dqn"
    """Of the algorithm."""
    parameters: Literal["own", "shared"] = "own"
    """Each robot has a network of its own, or all act by one, which learns from what each of them does
    (Gupta 2017)."""
    hidden: Many[Annotated[int, Field(ge=1, le=4096)]] = Field(
        default=(128, 128, 128), min_length=1, max_length=8
    )
    """Width of each hidden layer."""
    normalisation: Literal["none", "rms"] = "none"
    """`rms`: what a hidden layer puts out is divided by its root mean square (Zhang 2019), so that no state,
    however rare, is valued far above the others."""
    mask: bool = False
    """Moves that end at a wall or lead away from both goals are not chosen, where actions are cardinal and
    observations hold the gains of moves."""
    learning_rate: float = Field(default=1e-3, ge=1e-8, le=1)
    """Step size of Adam at the start."""
    learning_rate_end: float = Field(default=0.02, ge=0, le=1)
    """Share of the step size that is left at the end; it falls linearly. 1 keeps it."""
    discount: float = Field(default=0.95, ge=0, le=0.99999)
    """Gamma: what a reward one decision later is worth."""
    return_steps: int = Field(default=3, ge=1, le=1000)
    """Decisions whose rewards are summed before the estimate of what follows takes over."""
    batch_size: int = Field(default=64, ge=1, le=65_536)
    """Transitions of each robot in an update."""
    epsilon_start: float = Field(default=1.0, ge=0, le=1)
    """Share of random actions at the start."""
    epsilon_end: float = Field(default=0.02, ge=0, le=1)
    """Share of random actions once exploration has run down."""
    epsilon_spread: float = Field(default=7.0, ge=0, le=1000)
    """How much less further environments explore: the i-th of n by epsilon ** (1 + spread * i / (n - 1))."""
    exploration: float = Field(default=0.1, ge=0, le=1)
    """Share of a stage over which the share of random actions falls."""
    replay_capacity: int = Field(default=100_000, ge=1, le=10**8)
    """Transitions kept of each robot; the oldest go first."""
    warmup: int = Field(default=1000, ge=0, le=10**10)
    """Joint decisions before the first update."""
    updates_per_step: float = Field(default=0.5, ge=0, le=1000)
    """Updates per joint decision."""
    target_interval: int = Field(default=100, ge=1, le=10**9)
    """Updates between two copies of the network into its target network."""
    reward_scale: float = Field(default=0.1, ge=1e-6, le=1e6)
    """Factor on rewards before learning."""
    device: str = Field(default="cpu", max_length=20)
    """Where the networks learn: cpu, or cuda for a GPU. The environments always run on the processor."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """What the matrix products of an update round to; bfloat16 where torch does it on this machine."""

    @model_validator(mode="after")
    def _check_epsilon(self) -> Self:
        if self.epsilon_end > self.epsilon_start:
            raise ValueError(
                f"epsilon_end is {self.epsilon_end}, but must be a number of at most epsilon_start, "
                f"{self.epsilon_start}"
            )
        return self

    @property
    def shares_parameters(self) -> bool:
        return self.parameters == "shared"

    def epsilon(self, progress: float) -> float:
        """Return the share of random actions at `progress` (0 to 1) of a stage; it falls, then stays."""
        explored = 1.0 if self.exploration == 0.0 else min(1.0, progress / self.exploration)
        return self.epsilon_start + (self.epsilon_end - self.epsilon_start) * explored

    def epsilons(self, epsilon: float, num_envs: int) -> NDArray[np.float64]:
        """Return the share of random actions in each environment, [envs], from that of the first.

        All but the first soon act almost greedily (Horgan 2018), so that experience holds what the finished
        team would do, standstill included.
        """
        place = np.arange(num_envs) / max(1, num_envs - 1)
        return np.asarray(epsilon ** (1.0 + self.epsilon_spread * place))

    def learning_rate_at(self, progress: float) -> float:
        """Return Adam's step size at `progress` (0 to 1) of a stage: it falls linearly."""
        return self.learning_rate * (1.0 + (self.learning_rate_end - 1.0) * min(1.0, progress))

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration with the layers and the mask of `spec`.

        Networks that learned with normalised layers or behind a mask know nothing of acting without.
        """
        if (spec.input, spec.activation, spec.output) != ("own", "relu", "action values"):
            raise InputError(
                f"has networks from {spec.input} observations to {spec.output} by {spec.activation}, but "
                'must have ones from own observations to action values by relu for the algorithm "dqn".'
            )
        if spec.hidden != self.hidden:
            raise InputError(
                f"has hidden layers {shown(spec.hidden)}, but must have {shown(self.hidden)}, as hidden says."
            )
        if self.shares_parameters and spec.networks > 1:
            raise InputError(
                'has a network for each robot, but must have one for all where parameters is "shared".'
            )
        return self.changed(normalisation=spec.normalisation, mask=spec.mask)

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> DoubleDqn:
        # Here, since reading a configuration must not load torch.
        from robosim.learning.algorithms.dqn.algorithm import DoubleDqn

        return DoubleDqn(self, task, seed, start)
