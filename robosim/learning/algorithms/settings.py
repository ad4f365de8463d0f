"""Settings that several algorithms have in common."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from robosim.control.network import Activation, NetworkSpec, Output
from robosim.errors import InputError, shown
from robosim.learning.algorithms.protocol import AlgorithmConfig, Task
from robosim.records import Many

Widths = Annotated[Many[Annotated[int, Field(ge=1, le=4096)]], Field(min_length=1, max_length=8)]
StepSize = Annotated[float, Field(ge=1e-8, le=1)]


class LearnerConfig(AlgorithmConfig):
    """Base of the configurations of algorithms that learn networks by gradient steps."""

    hidden: Widths = (128, 128, 128)
    """Width of each hidden layer."""
    learning_rate: StepSize = 1e-3
    """Step size of Adam at the start."""
    learning_rate_end: float = Field(default=0.02, ge=0, le=1)
    """Share of the step size that is left at the end; it falls linearly. 1 keeps it."""
    discount: float = Field(default=0.95, ge=0, le=0.99999)
    """Gamma: what a reward one decision later is worth."""
    reward_scale: float = Field(default=0.1, ge=1e-6, le=1e6)
    """Factor on rewards before learning."""

    def learning_rate_at(self, progress: float) -> float:
        """Return the step size at `progress` (0 to 1) of a stage: it falls linearly."""
        return self.learning_rate * (1.0 + (self.learning_rate_end - 1.0) * min(1.0, progress))

    def require_networks(
        self, spec: NetworkSpec, sees: Literal["own", "team"], activation: Activation, puts_out: Output
    ) -> None:
        """Raise InputError, a sentence that begins with "has", for networks of another kind."""
        own, theirs = (
            (sees, activation, "none", puts_out, self.hidden),
            (spec.input, spec.activation, spec.normalisation, spec.output, spec.hidden),
        )
        if own != theirs:
            raise InputError(
                f"has networks of {shown(theirs)}, but must have ones of {shown(own)} for the algorithm "
                f"{shown(self.name)} (input, activation, normalisation, output, hidden)."
            )


class MaskConfig(LearnerConfig):
    """Base of those whose robots may be kept from blocked moves."""

    mask: bool = False
    """Moves that end at a wall or lead away from both goals are not chosen, where observations hold the gains
    of moves; exploration by chance, with epsilon, draws from all actions."""

    def own_networks(self, task: Task, output: Output) -> NetworkSpec:
        """Return what networks are by which each robot acts on its own observation, with ReLU."""
        return NetworkSpec(
            inputs=task.size,
            hidden=self.hidden,
            mask=self.mask and task.gains is not None,
            output=output,
            actions=task.num_actions,
            of_robot=self.network_of_robot(task),
        )

    def network_of_robot(self, task: Task) -> tuple[int, ...]:
        """Return which network each robot acts by, [robots]."""
        if not self.shares_parameters:
            return tuple(range(task.robots))
        return task.groups if self.shares_by_group and task.groups else (0,) * task.robots


class ReplayConfig(LearnerConfig):
    """Base of those that learn from a replay."""

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

    def capacity(self, task: Task) -> int:
        """Return the transitions to keep: more than there are decisions would be reserved in vain."""
        return max(min(self.replay_capacity, task.decisions + task.num_envs), task.num_envs)

    def updates_due(self, decisions: int) -> int:
        """Return how many updates there should have been after so many joint decisions."""
        return int(max(0, decisions - self.warmup) * self.updates_per_step)
