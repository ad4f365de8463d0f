"""What actor-critics share: stacked actors and critics, the rollout they learn from, advantages, saving.

All networks are stacked, one batched product a layer; a network that robots share is a stack of one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from robosim.control.network import NetworkSpec, Output
from robosim.discretise.observation import MoveGains, blocked_moves
from robosim.errors import InputError, shown
from robosim.learning.algorithms.protocol import Actors, AlgorithmConfig, Experience, State, Task
from robosim.learning.computing import denormals_flushed
from robosim.learning.networks import NetworkShape, Parameters, initialise
from robosim.records import Many

Floats = NDArray[np.float32]
Activation = Literal["relu", "tanh"]

_NEVER = -1e9
"""Logit of a blocked move: finite, so that its share of the entropy is 0 and not undefined."""


class ActorCriticConfig(AlgorithmConfig):
    """Base of the configurations of actor-critics that learn from what their present policy did."""

    actor_kind: ClassVar[tuple[Literal["own", "team"], Output]] = ("own", "logits")
    """What goes into an actor, and what comes out, as in `NetworkSpec`."""

    hidden: Many[Annotated[int, Field(ge=1, le=4096)]] = Field(default=(128, 128), min_length=1, max_length=8)
    """Width of each hidden layer, of the actor and of the critic."""
    activation: Activation = "tanh"
    """Of the hidden layers."""
    mask: bool = False
    """Moves that end at a wall or lead away from both goals are not chosen, where actions are cardinal and
    observations hold the gains of moves."""
    rollout: int = Field(default=16, ge=1, le=10_000)
    """Decisions of every environment in an update."""
    learning_rate: float = Field(default=2e-3, ge=1e-8, le=1)
    """Step size of Adam at the start."""
    learning_rate_end: float = Field(default=0.02, ge=0, le=1)
    """Share of the step size that is left at the end; it falls linearly. 1 keeps it."""
    discount: float = Field(default=0.95, ge=0, le=0.99999)
    """Gamma: what a reward one decision later is worth."""
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    """How far advantages trust rewards before the critic: 0 one decision, 1 to the end of the rollout."""
    entropy_weight: float = Field(default=0.1, ge=0, le=100)
    """Of the entropy of what the actor chooses, which keeps it trying."""
    value_weight: float = Field(default=0.5, ge=0, le=100)
    """Of the critic's error."""
    gradient_norm: float = Field(default=0.5, ge=1e-6, le=1e6)
    """Most that the gradient of a robot's networks may measure; longer ones are shortened."""
    reward_scale: float = Field(default=0.1, ge=1e-6, le=1e6)
    """Factor on rewards before learning."""

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration with the mask of `spec`."""
        sees, puts_out = self.actor_kind
        own, theirs = (
            (sees, self.activation, "none", puts_out, self.hidden),
            (spec.input, spec.activation, spec.normalisation, spec.output, spec.hidden),
        )
        if own != theirs:
            raise InputError(
                f"has networks of {shown(theirs)}, but must have ones of {shown(own)} for the algorithm "
                f"{shown(self.name)} (input, activation, normalisation, output, hidden)."
            )
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
        self.actor, self.critic = _new_layers(actor, actors), _new_layers(critic, critics)
        if start is not None:
            # By name: a checkpoint gives them back in another order.
            arrays = [start.weights[name] for name in start.spec.shapes]
            _load(self.actor, [torch.from_numpy(array.copy()) for array in arrays])
        self._parameters = [one.requires_grad_() for one in (*self.actor, *self.critic)]
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
        rollout = _stacked(self._rollout)
        self._rollout, self._stale = [], True
        rate = config.learning_rate * (1.0 + (config.learning_rate_end - 1.0) * min(1.0, progress))
        self._adam.param_groups[0]["lr"] = rate
        with denormals_flushed():
            figures = self._learn(rollout)
        return figures | {"learning_rate": rate}

    def actors(self) -> Actors:
        shapes = self.spec.shapes
        arrays = (
            one.detach().numpy().copy().reshape(shape)
            for one, shape in zip(self.actor, shapes.values(), strict=True)
        )
        return Actors(self.spec, dict(zip(shapes, arrays, strict=True)))

    def state(self) -> State:
        tensors = {f"parameter{i}": one.detach().clone() for i, one in enumerate(self._parameters)}
        for i, one in enumerate(self._parameters):
            for name, tensor in self._adam.state.get(one, {}).items():
                tensors[f"adam{i}.{name}"] = tensor.clone()
        if self._rollout:
            held = _stacked(self._rollout)._asdict()
            tensors |= {f"rollout.{name}": torch.from_numpy(array) for name, array in held.items()}
        return State(tensors, {"stale": self._stale, "rng": self._rng.bit_generator.state})

    def restore(self, state: State) -> None:
        tensors, facts = state
        _load(self._parameters, [tensors[f"parameter{i}"] for i in range(len(self._parameters))])
        self._adam.state.clear()
        for i, one in enumerate(self._parameters):
            moments = _part(tensors, f"adam{i}.")
            if moments:
                self._adam.state[one] = {name: tensor.clone() for name, tensor in moments.items()}
        held = _part(tensors, "rollout.")
        decisions = zip(*(held[name].numpy() for name in Experience._fields), strict=True) if held else ()
        self._rollout = [Experience(*decision) for decision in decisions]
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
        logits = forward(self.actor, observation, self.config.activation)
        if self._gains is None:
            return logits
        return logits.masked_fill(self._blocked(observation, self._gains), _NEVER)

    def _blocked(self, observation: Tensor, gains: MoveGains) -> Tensor:
        """Return which actions [..., robots, actions] are not chosen."""
        blocked = blocked_moves(observation, gains)
        rest = blocked.new_zeros((*blocked.shape[:-1], self.task.num_actions - blocked.shape[-1]))
        return torch.cat((blocked, rest), dim=-1)

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
        return forward(self.critic, observation, self.config.activation)[..., 0]

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
        # By each robot's own: over all robots, one that earns much would drown the others.
        scaled = torch.from_numpy(standardised(gained, (0, 1)))
        taken, entropy = log_chances(self._logits(observation), torch.from_numpy(rollout.action))
        return of_networks(self.networks, (-taken * scaled, (values - returns).square(), entropy))


class Losses(NamedTuple):
    """Of each network, [networks]."""

    policy: Tensor
    value: Tensor
    entropy: Tensor


def own_actors(config: OwnActorsConfig, task: Task) -> NetworkSpec:
    """Return what actors are that see a robot's own observation."""
    return NetworkSpec(
        inputs=task.size,
        hidden=config.hidden,
        activation=config.activation,
        mask=config.mask and task.gains is not None,
        output="logits",
        actions=task.num_actions,
        of_robot=(0,) * task.robots if config.shares_parameters else tuple(range(task.robots)),
    )


def forward(layers: Sequence[Tensor], observation: Tensor, activation: Activation) -> Tensor:
    """Return what networks put out, [..., robots, outputs], of `observation` [..., robots, size].

    `layers` are weights [networks, in, out] and biases [networks, 1, out] by turns. Each robot has a network,
    or all have the only one.
    """
    *batch, robots, size = observation.shape
    hidden = observation.reshape(-1, robots, size).transpose(0, 1)
    if len(layers[0]) == 1:
        hidden = hidden.reshape(1, -1, size)
    for layer in range(0, len(layers), 2):
        hidden = torch.baddbmm(layers[layer + 1], hidden, layers[layer])
        if layer < len(layers) - 2:
            hidden = activated(hidden, activation)
    return hidden.reshape(robots, -1, hidden.shape[-1]).transpose(0, 1).reshape(*batch, robots, -1)


def activated(hidden: Tensor, activation: Activation) -> Tensor:
    """Return what a hidden layer makes of its sums."""
    return torch.tanh(hidden) if activation == "tanh" else torch.relu(hidden)


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


def standardised(numbers: Floats, axes: tuple[int, ...]) -> Floats:
    """Return numbers less their mean over their deviation, both taken over `axes`."""
    spread = numbers.std(axis=axes, keepdims=True) + np.float32(1e-8)
    scaled: Floats = (numbers - numbers.mean(axis=axes, keepdims=True)) / spread
    return scaled


def shorten_gradients(parameters: Sequence[Tensor], most: float) -> Tensor:
    """Shorten the gradient of each network, over all of `parameters` [networks, ...], to `most`.

    Returns the lengths before, [networks].
    """
    gradients = [one.grad for one in parameters if one.grad is not None]
    squares = torch.stack([gradient.square().sum(dim=(1, 2)) for gradient in gradients])
    norms = squares.sum(dim=0).sqrt()
    factors = (most / (norms + 1e-6)).clamp(max=1.0)
    for gradient in gradients:
        gradient.mul_(factors[:, None, None])
    return norms


def _new_layers(shape: NetworkShape, seed: np.random.SeedSequence) -> list[Tensor]:
    """Return weights [networks, in, out] and biases [networks, 1, out] by turns."""
    parameters = Parameters(shape)
    initialise(parameters, seed.spawn(shape.robots))
    pairs = zip(parameters.weights, parameters.biases, strict=True)
    layers = [tensor.clone(memory_format=torch.contiguous_format) for pair in pairs for tensor in pair]
    # Near zero at first: all actions are about as likely, and nothing is expected.
    layers[-2].mul_(0.01)
    layers[-1].zero_()
    return layers


def _load(into: Sequence[Tensor], tensors: Sequence[Tensor]) -> None:
    with torch.no_grad():
        for one, given in zip(into, tensors, strict=True):
            if one.numel() != given.numel():
                raise InputError(
                    f"a layer has the shape {shown(tuple(given.shape))}, but must have "
                    f"{shown(tuple(one.shape))}."
                )
            one.copy_(given.reshape(one.shape))


def _stacked(decisions: Sequence[Experience]) -> Experience:
    return Experience(*map(np.stack, zip(*decisions, strict=True)))


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): one for name, one in tensors.items() if name.startswith(prefix)}
