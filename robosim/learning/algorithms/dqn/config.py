"""The configuration of Double DQN."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from pydantic import Field

from robosim.control.network import NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.protocol import Actors, Task
from robosim.learning.algorithms.settings import ReplayConfig
from robosim.learning.algorithms.values import OwnValuesConfig, ValueConfig

if TYPE_CHECKING:
    from robosim.learning.algorithms.dqn.algorithm import DoubleDqn


class DoubleQConfig(ReplayConfig, ValueConfig):
    """Base of those that learn action values by Double-Q targets from a replay, with target networks."""

    target_interval: int = Field(default=100, ge=1, le=10**9)
    """Updates between two copies of the network into its target network."""


class DqnConfig(OwnValuesConfig, DoubleQConfig):
    """Double DQN with experience replay (van Hasselt 2016)."""

    name: Literal["dqn"] = "dqn"
    """Of the algorithm."""
    parameters: Literal["own", "shared", "group"] = "own"  # type: ignore[assignment]  # wider than the base's
    """Each robot has a network of its own, or all act by one, which learns from what each of them does
    (Gupta 2017); or each group of a mixed team has one."""
    normalisation: Literal["none", "rms"] = "none"
    """`rms`: what a hidden layer puts out is divided by its root mean square (Zhang 2019), so that no state,
    however rare, is valued far above the others."""
    device: str = Field(default="cpu", max_length=20)
    """Where the networks learn: cpu, or cuda for a GPU. The environments always run on the processor."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """What the matrix products of an update round to; bfloat16 where torch does it on this machine."""

    @property
    def shares_parameters(self) -> bool:
        return self.parameters != "own"

    @property
    def shares_by_group(self) -> bool:
        return self.parameters == "group"

    def starting_from(self, spec: NetworkSpec) -> Self:
        if self.shares_by_group:
            raise InputError('cannot be gone on from where parameters is "group", but must be left out.')
        return super().starting_from(spec)

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> DoubleDqn:
        # Here, since reading a configuration must not load torch.
        from robosim.learning.algorithms.dqn.algorithm import DoubleDqn

        return DoubleDqn(self, task, seed, start)
