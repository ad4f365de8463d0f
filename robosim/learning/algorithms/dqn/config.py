"""The configuration of Double DQN."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from pydantic import Field

from robosim.control.network import NetworkSpec
from robosim.learning.algorithms.protocol import Actors, Task
from robosim.learning.algorithms.values import ValueConfig

if TYPE_CHECKING:
    from robosim.learning.algorithms.dqn.algorithm import DoubleDqn


class ReplayConfig(ValueConfig):
    """Base of the configurations of algorithms that learn from a replay, with target networks."""

    return_steps: int = Field(default=3, ge=1, le=1000)
    """Decisions whose rewards are summed before the estimate of what follows takes over."""
    batch_size: int = Field(default=64, ge=1, le=65_536)
    """Transitions of each robot in an update."""
    replay_capacity: int = Field(default=100_000, ge=1, le=10**8)
    """Transitions kept of each robot; the oldest go first."""
    warmup: int = Field(default=1000, ge=0, le=10**10)
    """Joint decisions before the first update."""
    updates_per_step: float = Field(default=0.5, ge=0, le=1000)
    """Updates per joint decision."""
    target_interval: int = Field(default=100, ge=1, le=10**9)
    """Updates between two copies of the network into its target network."""

    def capacity(self, task: Task) -> int:
        """Return the transitions to keep: more than there are decisions would be reserved in vain."""
        return max(min(self.replay_capacity, task.decisions + task.num_envs), task.num_envs)

    def updates_due(self, decisions: int) -> int:
        """Return how many updates there should have been after so many joint decisions."""
        return int(max(0, decisions - self.warmup) * self.updates_per_step)


class DqnConfig(ReplayConfig):
    """Double DQN with experience replay (van Hasselt 2016)."""

    name: Literal["dqn"] = "dqn"
    """Of the algorithm."""
    parameters: Literal["own", "shared"] = "own"
    """Each robot has a network of its own, or all act by one, which learns from what each of them does
    (Gupta 2017)."""
    normalisation: Literal["none", "rms"] = "none"
    """`rms`: what a hidden layer puts out is divided by its root mean square (Zhang 2019), so that no state,
    however rare, is valued far above the others."""
    mask: bool = False
    """Moves that end at a wall or lead away from both goals are not chosen, where actions are cardinal and
    observations hold the gains of moves."""
    device: str = Field(default="cpu", max_length=20)
    """Where the networks learn: cpu, or cuda for a GPU. The environments always run on the processor."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """What the matrix products of an update round to; bfloat16 where torch does it on this machine."""

    @property
    def shares_parameters(self) -> bool:
        return self.parameters == "shared"

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration with the layers and the mask of `spec`.

        Networks that learned with normalised layers or behind a mask know nothing of acting without.
        """
        self.require_action_values(spec)
        return self.changed(normalisation=spec.normalisation, mask=spec.mask)

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> DoubleDqn:
        # Here, since reading a configuration must not load torch.
        from robosim.learning.algorithms.dqn.algorithm import DoubleDqn

        return DoubleDqn(self, task, seed, start)
