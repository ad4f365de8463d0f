"""What actor-critics share: stacked actors and critics, the rollout they learn from, advantages, saving.

All networks are stacked, one batched product a layer; a network that robots share is a stack of one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from robosim.control.network import Activation, NetworkSpec, Output
from robosim.errors import InputError
from robosim.learning.algorithms.protocol import Actors, Experience, State, Task
from robosim.learning.algorithms.rollout import restored_rollout, rollout_state, stack_decisions
from robosim.learning.algorithms.settings import MaskConfig, StepSize, Widths
from robosim.learning.algorithms.stacked import (
    StackedNetworks,
    mask_blocked,
    optimiser_state,
    part,
    prefixed,
    restore_optimiser,
    shorten_gradients,
)
from robosim.learning.computing import denormals_flushed
from robosim.learning.networks import NetworkShape

Floats = NDArray[np.float32]

NEVER = -1e9
"""Logit of a blocked move: finite, so that its share of the entropy is 0 and not undefined."""


class ActorCriticConfig(MaskConfig):
    """Base of the configurations of actor-critics that learn from what their present policy did."""

    actor_kind: ClassVar[tuple[Literal["own", "team"], Output]] = ("own", "logits")
    """What goes into an actor, and what comes out, as in `NetworkSpec`."""

    hidden: Widths = (128, 128)
    """Width of each hidden layer, of the actor and of the critic."""
    activation: Activation = "tanh"
    """Of the hidden layers."""
    rollout: int = Field(default=16, ge=1, le=10_000)
    """Decisions of every environment in an update."""
    learning_rate: StepSize = 2e-3
    """Step size of Adam at the start."""
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    """How far advantages trust rewards before the critic: 0 one decision, 1 to the end of the rollout."""
    entropy_weight: float = Field(default=0.1, ge=0, le=100)
    """Of the entropy of what the actor chooses, which keeps it trying."""
    value_weight: float = Field(default=0.5, ge=0, le=100)
    """Of the critic's error."""
    gradient_norm: float = Field(default=0.5, ge=1e-6, le=1e6)
    """Most that the gradient of a robot's networks may measure; longer ones are shortened."""

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration with the mask of `spec`."""
        sees, puts_out = self.actor_kind
        self.require_networks(spec, sees, self.activation, puts_out)
        if self.shares_parameters and spec.networks > 1:
            raise InputError(
                'has a network for each robot, but must have one for all where parameters is "shared".'
            )
        return self.changed(mask=spec.mask)


class OwnActorsConfig(ActorCriticConfig):
    """Base of those in which each robot acts by its own observation."""

    parameters: Literal["own", "shared"] = "own"
    """Each robot has an actor and a critic of its own, or all have the same, which learn from all."""

    @property
    def shares_parameters(self) -> bool:
        return self.parameters == "shared"


class ActorCritic(ABC):
    """Actors and critics of the robots that learn, and the rollout they learn from next.

    The decision under way at an update was chosen before it and is left out, so that a rollout holds
    decisions of the present policy alone.
    """

    def __init__(
        self,
        config: ActorCriticConfig,
        task: Task,
        seed: np.random.SeedSequence,
        start: Actors | None,
        spec: NetworkSpec,
        critic: NetworkShape,
    ) -> None:
        """`spec` says what the actors are, `critic` what the critics; one critic for each actor.

        `start` gives the actors; critics always begin anew.
        """
        self.config, self.task, self.spec = config, task, spec
        self._gains = task.gains if spec.mask else None
        choose, actors, critics = seed.spawn(3)
        self._rng = np.random.default_rng(choose)
        self.networks = spec.networks
        actor = NetworkShape(spec.networks, spec.inputs, spec.hidden, spec.outputs)
        self.actor, self.critic = (
            _near_zero(StackedNetworks.draw(shape, parent.spawn(shape.robots), config.activation))
            for shape, parent in ((actor, actors), (critic, critics))
        )
        if start is not None:
            self.actor.load(start.weights)
        self._parameters = [*self.actor.parameters, *self.critic.parameters]
        self._adam = torch.optim.Adam(self._parameters, lr=config.learning_rate, eps=1e-5)
        self._rollout: list[Experience] = []
        self._stale = False
        """Whether the decision under way was chosen before the latest update."""

    def act(self, observation: Floats, progress: float) -> NDArray[np.int64]:
        with torch.no_grad():
            logits = self._logits(torch.from_numpy(np.ascontiguousarray(observation))).numpy()
        return drawn(logits, self._rng)

    def observe(self, experience: Experience) -> None:
        if not self._stale:
            self._rollout.append(experience)
        self._stale = False

    def update(self, progress: float) -> dict[str, float]:
        config = self.config
        if len(self._rollout) < config.rollout:
            return {}
        rollout = stack_decisions(self._rollout)
        self._rollout, self._stale = [], True
        rate = config.learning_rate_at(progress)
        self._adam.param_groups[0]["lr"] = rate
        with denormals_flushed():
            figures = self._learn(rollout)
        return figures | {"learning_rate": rate}

    def actors(self) -> Actors:
        return Actors(self.spec, self.actor.to_numpy())

    def state(self) -> State:
        tensors = prefixed("optimiser.", optimiser_state(self._adam)) | rollout_state(self._rollout)
        return State(tensors, {"stale": self._stale, "rng": self._rng.bit_generator.state})

    def restore(self, state: State) -> None:
        tensors, facts = state
        restore_optimiser(self._adam, part(tensors, "optimiser."))
        self._rollout = restored_rollout(tensors)
        self._stale = bool(facts["stale"])
        self._rng.bit_generator.state = facts["rng"]

    @abstractmethod
    def _learn(self, rollout: Experience) -> dict[str, float]:
        """Learn from arrays [decisions, envs, ...] of the present policy; returns figures."""

    @abstractmethod
    def _values(self, observation: Tensor) -> Tensor:
        """Return what critics put out, [..., robots], of `observation` [..., robots, size]."""

    def _logits(self, observation: Tensor) -> Tensor:
        """Return the actors' logits [..., robots, actions] of `observation` [..., robots, size]."""
        return self._masked(self.actor.of_robots(observation), observation)

    def _masked(self, logits: Tensor, observation: Tensor) -> Tensor:
        """Return logits with those of actions that are not to be chosen out of reach."""
        return mask_blocked(logits, observation, self._gains, NEVER)

    def _descend(self, losses: Losses) -> None:
        """Fill the gradient of the networks' losses, summed: no network's weights occur in another's."""
        config = self.config
        total = losses.policy + config.value_weight * losses.value - config.entropy_weight * losses.entropy
        self._adam.zero_grad()
        total.sum().backward()  # type: ignore[no-untyped-call]


class AdvantageActorCritic(ActorCritic):
    """One step along the gradient of Mnih 2016 for each rollout; a critic sees what its actor sees."""

    def __init__(
        self,
        config: ActorCriticConfig,
        task: Task,
        seed: np.random.SeedSequence,
        start: Actors | None,
        spec: NetworkSpec,
    ) -> None:
        critic = NetworkShape(spec.networks, spec.inputs, config.hidden, 1)
        super().__init__(config, task, seed, start, spec, critic)

    def _values(self, observation: Tensor) -> Tensor:
        return self.critic.of_robots(observation)[..., 0]

    def _learn(self, rollout: Experience) -> dict[str, float]:
        losses = self._losses(rollout)
        self._descend(losses)
        norms = shorten_gradients(self._parameters, self.config.gradient_norm)
        self._adam.step()
        return {
            "policy_loss": losses.policy.mean().item(),
            "value_loss": losses.value.mean().item(),
            "entropy": losses.entropy.mean().item(),
            "gradient_norm": norms.mean().item(),
        }

    def _losses(self, rollout: Experience) -> Losses:
        """Return the losses of each network; arrays of the rollout are [decisions, envs, robots, ...]."""
        observation = torch.from_numpy(rollout.observation)
        values = self._values(observation)
        with torch.no_grad():
            following = self._values(torch.from_numpy(rollout.final_observation))
        gained = advantages(self.config, rollout, values.detach().numpy(), following.numpy())
        returns = torch.from_numpy(gained) + values.detach()
        scaled = torch.from_numpy(standardised(gained, self.networks))
        taken, entropy = log_chances(self._logits(observation), torch.from_numpy(rollout.action))
        return of_networks(self.networks, (-taken * scaled, (values - returns).square(), entropy))


class Losses(NamedTuple):
    """Of each network, [networks]."""

    policy: Tensor
    value: Tensor
    entropy: Tensor


def own_actors(config: OwnActorsConfig, task: Task) -> NetworkSpec:
    """Return what actors are that see a robot's own observation."""
    return config.own_networks(task, "logits").changed(activation=config.activation)


def drawn(logits: Floats, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return draws [...] from the softmax of `logits` [..., choices]."""
    # The largest sum with a Gumbel draw is one.
    chosen: NDArray[np.int64] = (logits + rng.gumbel(size=logits.shape)).argmax(axis=-1)
    return chosen


def log_chances(logits: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
    """Return the logarithm of the chance of `action` [...], and the entropy [...], for `logits` [..., n]."""
    chances = torch.log_softmax(logits, dim=-1)
    taken = chances.gather(-1, action[..., None])[..., 0]
    return taken, -(chances.exp() * chances).sum(dim=-1)


def of_networks(networks: int, each: Sequence[Tensor]) -> Losses:
    """Return the means [networks] of policy loss, value loss and entropy, each [..., robots]."""
    last = each[0].dim() - 1
    whole = tuple(range(last + 1 if networks == 1 else last))
    return Losses(*(part.mean(dim=whole).reshape(-1) for part in each))


def advantages(config: ActorCriticConfig, rollout: Experience, values: Floats, following: Floats) -> Floats:
    """Return the advantages of decisions, [decisions, envs, robots]: GAE within each episode (Schulman 2016).

    `values` and `following` [decisions, envs, robots] are those of what decisions saw and of what they led
    to: where an episode was cut off that still counts, where the task ended it does not.
    """
    discount, trace = np.float32(config.discount), np.float32(config.gae_lambda)
    reward = np.float32(config.reward_scale) * rollout.reward
    surprise = reward + discount * ~rollout.terminated[..., None] * following - values
    linked = discount * trace * ~rollout.ended[..., None]
    total = np.empty_like(surprise)
    later = np.zeros_like(surprise[0])
    for decision in reversed(range(len(surprise))):
        later = total[decision] = surprise[decision] + linked[decision] * later
    return total


def standardised(numbers: Floats, networks: int) -> Floats:
    """Return numbers [decisions, envs, robots] less their mean over their deviation, both of each network.

    Of each robot where each has a network. Where all share one, over them all: else a robot that stands
    still, whose advantages are the critic's noise, would count as much as one that works.
    """
    axes = (0, 1, 2) if networks == 1 else (0, 1)
    spread = numbers.std(axis=axes, keepdims=True) + np.float32(1e-8)
    scaled: Floats = (numbers - numbers.mean(axis=axes, keepdims=True)) / spread
    return scaled


def _near_zero(networks: StackedNetworks) -> StackedNetworks:
    """Bring outputs near zero: all actions are about as likely at first, and nothing is expected."""
    *_, weight, bias = networks.parameters
    with torch.no_grad():
        weight.mul_(0.01)
        bias.zero_()
    return networks
