"""MADDPG: each robot acts by its own observation and learns from a critic that sees the team (Lowe 2017).

Actions are discrete, so an actor learns through straight-through Gumbel-softmax draws (Jang 2017) at
temperature 1, as in EPyMARL (Papoudakis 2021). All robots' actors are stacked, and so are their critics: one
batched product a layer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor
from torch.nn.functional import one_hot

from robosim.control.network import NetworkSpec
from robosim.discretise.observation import mask_blocked_moves
from robosim.learning.algorithms.actor_critic import drawn
from robosim.learning.algorithms.dqn.replay import Batch
from robosim.learning.algorithms.memory import JointReplay
from robosim.learning.algorithms.protocol import Actors, State, Task
from robosim.learning.algorithms.settings import MaskConfig, ReplayConfig, Widths
from robosim.learning.algorithms.stacked import (
    StackedNetworks,
    mask_blocked,
    optimiser_state,
    part,
    prefixed,
    restore_optimiser,
    shorten_gradients,
)
from robosim.learning.computing import denormals_flushed, find_device
from robosim.learning.networks import CPU, ActionValues, NetworkShape, Parameters, initialise


class MaddpgConfig(MaskConfig, ReplayConfig):
    """MADDPG with discrete actions."""

    name: Literal["maddpg"] = "maddpg"
    """Of the algorithm."""
    hidden: Widths = (128, 128)
    """Width of each hidden layer, of the actors and of the critics."""
    return_steps: int = Field(default=1, ge=1, le=1000)
    """Decisions whose rewards are summed before the estimate of what follows takes over."""
    batch_size: int = Field(default=256, ge=1, le=65_536)
    """Joint transitions in an update; all robots learn from the same moments."""
    updates_per_step: float = Field(default=0.1, ge=0, le=1000)
    """Updates per joint decision."""
    tau: float = Field(default=0.01, gt=0, le=1)
    """How far the target networks follow the others with each update; 1 copies them."""
    logit_weight: float = Field(default=1e-3, ge=0, le=100)
    """Of the mean squared logit in an actor's loss, which keeps it from choosing the same for ever."""
    gradient_norm: float = Field(default=10.0, ge=1e-6, le=1e6)
    """Most that the gradient of an actor or a critic may measure; longer ones are shortened."""
    device: str | None = Field(default=None, max_length=20)
    """Where the networks learn: the processor by default, or cuda for a GPU. The environments always run on
    the processor."""

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration with the mask of `spec`."""
        self.require_networks(spec, "own", "relu", "logits")
        return self.changed(mask=spec.mask)

    @property
    def needs_team(self) -> bool:
        return True

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> Maddpg:
        return Maddpg(self, task, seed, start)


class Maddpg(JointReplay):
    """Actors and critics of the robots that learn; has a `LargeMemory`, its replay of joint transitions."""

    def __init__(
        self, config: MaddpgConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """Reserve the replay; `start` gives the actors, critics always begin anew.

        InputError when the replay exceeds the memory, or `start` does not fit.
        """
        choose, draw, actors, critics = seed.spawn(4)
        self.device = find_device(config.device or "cpu")
        super().__init__(config, task, choose, draw, self.device)
        self.config = config
        self._gains = task.gains if config.mask else None
        robots, size, actions = task.robots, task.size, task.num_actions
        team = robots * (size + actions)
        self.actor = _Networks(NetworkShape(robots, size, config.hidden, actions), actors, self.device)
        self.critic = _Networks(NetworkShape(robots, team, config.hidden, 1), critics, self.device)
        if start is not None:
            self.actor.begin_with(start.weights)
        self._act = ActionValues(self.actor.online)
        self._own = torch.eye(robots, dtype=torch.bool, device=self.device)[:, None, :, None]
        """[critic, 1, robot, 1] where the action is that of the critic's own robot."""

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        logits = mask_blocked_moves(self._act(observation), observation, self._gains)
        return drawn(logits, self._choose)

    def update(self, progress: float) -> dict[str, float]:
        rate = self.config.learning_rate_at(progress)
        figures: dict[str, Tensor] = {}
        while self._is_due():
            with denormals_flushed():
                figures = self._learn(self._next_batch(), rate)
        if not figures:
            return {}
        # Only once: a GPU must end what it was given before it can say a number.
        return {name: figure.item() for name, figure in figures.items()} | {"learning_rate": rate}

    def actors(self) -> Actors:
        return Actors(self.config.own_networks(self.task, "logits"), self.actor.online.to_numpy())

    def state(self) -> State:
        tensors, facts = super().state()
        networks = prefixed("actor.", self.actor.state()) | prefixed("critic.", self.critic.state())
        return State({**tensors, **networks}, facts)

    def restore(self, state: State) -> None:
        super().restore(state)
        self.actor.restore(part(state.tensors, "actor."))
        self.critic.restore(part(state.tensors, "critic."))

    def _learn(self, batch: Batch, rate: float) -> dict[str, Tensor]:
        """Make a step of every critic, then one of every actor, and let the target networks follow."""
        config = self.config
        value = self._value_loss(batch)
        norm = self.critic.step(value, rate, config.gradient_norm)
        losses = self._policy_losses(batch)
        self.actor.step(losses.policy + config.logit_weight * losses.logits, rate, config.gradient_norm)
        for networks in (self.actor, self.critic):
            networks.follow(config.tau)
        return {
            "policy_loss": losses.policy.mean(),
            "value_loss": value.mean(),
            "entropy": losses.entropy.mean(),
            "gradient_norm": norm,
        }

    def _value_loss(self, batch: Batch) -> Tensor:
        """Return the mean squared error of each robot's critic, [robots]."""
        config, actions = self.config, self.task.num_actions
        with torch.no_grad():
            logits = self.actor.following(batch.successors)
            best = mask_blocked(logits, batch.successors, self._gains).argmax(dim=-1)
            after = _of_team(batch.successors, one_hot(best, actions).float())
            follows = batch.continues * self.critic.following(after)
            goal = config.reward_scale * batch.rewards + config.discount**config.return_steps * follows
        taken = one_hot(batch.actions[..., 0], actions).float()
        values = self.critic.learning(_of_team(batch.observations, taken))
        return (values - goal).square().mean(dim=(1, 2))

    def _policy_losses(self, batch: Batch) -> _Losses:
        """Return the losses of each robot's actor.

        All robots draw their actions anew; a critic's gradient reaches that of its own robot alone.
        """
        logits = self.actor.learning(batch.observations)
        is_open = mask_blocked(logits, batch.observations, self._gains)
        noise = torch.from_numpy(self._draw.gumbel(size=tuple(logits.shape)).astype(np.float32))
        choice = straight_through(is_open + noise.to(self.device))
        others = choice.detach().transpose(0, 1)
        # [critic, transitions, robot, ...], then the robots side by side.
        actions = torch.where(self._own, choice[:, :, None], others)
        observations = batch.observations.transpose(0, 1).expand(len(actions), -1, -1, -1)
        values = self.critic.learning(torch.cat((observations, actions), dim=3).flatten(2))
        with torch.no_grad():
            entropy = torch.special.entr(is_open.softmax(dim=-1)).sum(dim=-1)
        each = (-values[..., 0], logits.square().mean(dim=-1), entropy)
        return _Losses(*(one.mean(dim=1) for one in each))


class _Losses(NamedTuple):
    """Of each robot's actor, [robots]."""

    policy: Tensor
    """Minus the critic's value of what the actor does."""
    logits: Tensor
    """Mean squared."""
    entropy: Tensor


class _Networks:
    """Stacked networks that learn by Adam, and the target networks that follow them."""

    def __init__(self, shape: NetworkShape, seed: np.random.SeedSequence, device: torch.device) -> None:
        self.online, self.target, gradient = (Parameters(shape, device) for _ in range(3))
        initialise(self.online, seed.spawn(shape.robots))
        self.target.flat.copy_(self.online.flat)
        self.learning, self.following = StackedNetworks(self.online), StackedNetworks(self.target)
        """The same memory, as autograd follows it."""
        self._leaves = [*self.learning.parameters[::2], *self.learning.parameters[1::2]]
        # Autograd sees the layers, and adds into views of one buffer; Adam sees the buffer.
        for leaf, view in zip(self._leaves, (*gradient.weights, *gradient.biases), strict=True):
            leaf.grad = view
        self.online.flat.grad = gradient.flat
        self._adam = torch.optim.Adam([self.online.flat], fused=True)

    def begin_with(self, weights: Mapping[str, NDArray[np.float32]]) -> None:
        """Take the weights of a policy, in the networks and their targets; InputError if they do not fit."""
        self.online.load(weights)
        self.target.flat.copy_(self.online.flat)

    def step(self, losses: Tensor, rate: float, most: float) -> Tensor:
        """Make a step down each network's own loss, [networks]; returns the gradients' mean length.

        A gradient longer than `most` is shortened to it first.
        """
        self._adam.zero_grad(set_to_none=False)
        losses.sum().backward(inputs=self._leaves)  # type: ignore[no-untyped-call]
        norms = shorten_gradients(self._leaves, most)
        self._adam.param_groups[0]["lr"] = rate
        self._adam.step()
        return norms.mean()

    def follow(self, tau: float) -> None:
        """Move the target networks toward the others by a share of `tau`."""
        self.target.flat.lerp_(self.online.flat, tau)

    def state(self) -> dict[str, Tensor]:
        """Return copies of all that `restore` takes."""
        return {**optimiser_state(self._adam), "target": self.target.flat.to(CPU, copy=True)}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned; InputError when it belongs to networks of other shapes."""
        restore_optimiser(self._adam, tensors)
        self.target.flat.copy_(tensors["target"])


def straight_through(scores: Tensor) -> Tensor:
    """Return one-hots of the largest of `scores` [..., actions], with the gradient of their softmax."""
    soft = scores.softmax(dim=-1)
    hard = one_hot(scores.argmax(dim=-1), scores.shape[-1]).float()
    return hard + (soft - soft.detach())


def _of_team(observations: Tensor, actions: Tensor) -> Tensor:
    """Return what every critic sees, [robots, rows, all robots' numbers]: the same for all of them.

    `observations` are [robots, rows, size], `actions` [robots, rows, actions].
    """
    each = torch.cat((observations, actions), dim=2)
    return each.transpose(0, 1).flatten(1).expand(len(each), -1, -1)
