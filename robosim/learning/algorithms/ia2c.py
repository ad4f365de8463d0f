"""Independent advantage actor-critics (I-A2C): each robot an actor and a critic of its own observation.

The advantages are those of Schulman 2016 (GAE), the gradient is that of Mnih 2016. All robots' networks are
stacked, one batched product a layer; with shared parameters one actor and one critic serve all.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from robosim.control.network import NetworkSpec
from robosim.discretise.observation import blocked_moves
from robosim.errors import InputError, shown
from robosim.learning.algorithms.protocol import Actors, AlgorithmConfig, Experience, State, Task
from robosim.learning.computing import denormals_flushed
from robosim.learning.networks import NetworkShape, Parameters, initialise
from robosim.records import Many

_NEVER = -1e9
"""Logit of a blocked move: finite, so that its share of the entropy is 0 and not undefined."""


class Ia2cConfig(AlgorithmConfig):
    """Independent advantage actor-critic."""

    name: Literal["ia2c"] = "ia2c"
    """Of the algorithm."""
    parameters: Literal["own", "shared"] = "own"
    """Each robot has an actor and a critic of its own, or all have the same, which learn from all."""
    hidden: Many[Annotated[int, Field(ge=1, le=4096)]] = Field(default=(128, 128), min_length=1, max_length=8)
    """Width of each hidden layer, of the actor and of the critic."""
    activation: Literal["relu", "tanh"] = "tanh"
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

    @property
    def shares_parameters(self) -> bool:
        return self.parameters == "shared"

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration with the mask of `spec`."""
        own, theirs = (
            ("own", self.activation, "none", "logits", self.hidden),
            (spec.input, spec.activation, spec.normalisation, spec.output, spec.hidden),
        )
        if own != theirs:
            raise InputError(
                f"has networks of {shown(theirs)}, but must have ones of {shown(own)} for the algorithm "
                '"ia2c" (input, activation, normalisation, output, hidden).'
            )
        if self.shares_parameters and spec.networks > 1:
            raise InputError(
                'has a network for each robot, but must have one for all where parameters is "shared".'
            )
        return self.changed(mask=spec.mask)

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> Ia2c:
        return Ia2c(self, task, seed, start)


class Ia2c:
    """Actors and critics of the robots that learn, and the rollout they learn from next."""

    def __init__(
        self, config: Ia2cConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """`start` gives the actors; critics always begin anew."""
        self.config, self.task = config, task
        self._gains = task.gains if config.mask else None
        choose, actors, critics = seed.spawn(3)
        self._rng = np.random.default_rng(choose)
        self.networks = 1 if config.shares_parameters else task.robots
        self.actor = self._network(task.num_actions, actors)
        self.critic = self._network(1, critics)
        # Near zero at first: all actions are about as likely, and nothing is expected.
        for layers in (self.actor, self.critic):
            layers[-2].mul_(0.01)
            layers[-1].zero_()
        if start is not None:
            # By name: a checkpoint gives them back in another order.
            arrays = [start.weights[name] for name in start.spec.shapes]
            self._load(self.actor, [torch.from_numpy(array.copy()) for array in arrays])
        self._parameters = [one.requires_grad_() for one in (*self.actor, *self.critic)]
        self._adam = torch.optim.Adam(self._parameters, lr=config.learning_rate, eps=1e-5)
        self._rollout: list[Experience] = []
        self._stale = False
        """Whether the decision under way was chosen before the latest update."""

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        with torch.no_grad():
            logits = self._logits(torch.from_numpy(np.ascontiguousarray(observation))).numpy()
        # The largest sum with a Gumbel draw is a draw from the softmax.
        drawn: NDArray[np.int64] = (logits + self._rng.gumbel(size=logits.shape)).argmax(axis=-1)
        return drawn

    def observe(self, experience: Experience) -> None:
        if not self._stale:
            self._rollout.append(experience)
        self._stale = False

    def update(self, progress: float) -> dict[str, float]:
        config = self.config
        if len(self._rollout) < config.rollout:
            return {}
        rollout = Experience(*map(np.stack, zip(*self._rollout, strict=True)))
        self._rollout, self._stale = [], True
        rate = config.learning_rate * (1.0 + (config.learning_rate_end - 1.0) * min(1.0, progress))
        self._adam.param_groups[0]["lr"] = rate
        with denormals_flushed():
            losses = self._losses(rollout)
            total = (
                losses.policy + config.value_weight * losses.value - config.entropy_weight * losses.entropy
            )
            self._adam.zero_grad()
            total.sum().backward()  # type: ignore[no-untyped-call]
            norm = self._clip()
            self._adam.step()
        return {
            "policy_loss": losses.policy.mean().item(),
            "value_loss": losses.value.mean().item(),
            "entropy": losses.entropy.mean().item(),
            "gradient_norm": norm,
            "learning_rate": rate,
        }

    def actors(self) -> Actors:
        config, task = self.config, self.task
        spec = NetworkSpec(
            inputs=task.size,
            hidden=config.hidden,
            activation=config.activation,
            mask=self._gains is not None,
            output="logits",
            actions=task.num_actions,
            of_robot=(0,) * task.robots if config.shares_parameters else tuple(range(task.robots)),
        )
        arrays = (
            one.detach().numpy().copy().reshape(shape)
            for one, shape in zip(self.actor, spec.shapes.values(), strict=True)
        )
        return Actors(spec, dict(zip(spec.shapes, arrays, strict=True)))

    def state(self) -> State:
        tensors = {f"parameter{i}": one.detach().clone() for i, one in enumerate(self._parameters)}
        for i, one in enumerate(self._parameters):
            for name, tensor in self._adam.state.get(one, {}).items():
                tensors[f"adam{i}.{name}"] = tensor.clone()
        if self._rollout:
            stacked = Experience(*map(np.stack, zip(*self._rollout, strict=True)))
            tensors |= {f"rollout.{n}": torch.from_numpy(array) for n, array in stacked._asdict().items()}
        return State(tensors, {"stale": self._stale, "rng": self._rng.bit_generator.state})

    def restore(self, state: State) -> None:
        tensors, facts = state
        self._load(self._parameters, [tensors[f"parameter{i}"] for i in range(len(self._parameters))])
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

    def _network(self, outputs: int, seed: np.random.SeedSequence) -> list[Tensor]:
        """Return weights [networks, in, out] and biases [networks, 1, out] by turns."""
        parameters = Parameters(NetworkShape(self.networks, self.task.size, self.config.hidden, outputs))
        initialise(parameters, seed.spawn(self.networks))
        pairs = zip(parameters.weights, parameters.biases, strict=True)
        return [tensor.clone(memory_format=torch.contiguous_format) for pair in pairs for tensor in pair]

    def _load(self, into: list[Tensor], tensors: list[Tensor]) -> None:
        with torch.no_grad():
            for one, given in zip(into, tensors, strict=True):
                if one.numel() != given.numel():
                    raise InputError(
                        f"a layer has the shape {shown(tuple(given.shape))}, but must have "
                        f"{shown(tuple(one.shape))}."
                    )
                one.copy_(given.reshape(one.shape))

    def _forward(self, layers: list[Tensor], observation: Tensor) -> Tensor:
        """Return what networks put out, [..., robots, outputs], of `observation` [..., robots, size]."""
        *batch, robots, size = observation.shape
        hidden = observation.reshape(-1, robots, size).transpose(0, 1)
        if self.networks == 1:
            hidden = hidden.reshape(1, -1, size)
        for layer in range(0, len(layers), 2):
            hidden = torch.baddbmm(layers[layer + 1], hidden, layers[layer])
            if layer < len(layers) - 2:
                hidden = torch.tanh(hidden) if self.config.activation == "tanh" else torch.relu(hidden)
        return hidden.reshape(robots, -1, hidden.shape[-1]).transpose(0, 1).reshape(*batch, robots, -1)

    def _logits(self, observation: Tensor) -> Tensor:
        logits = self._forward(self.actor, observation)
        if self._gains is None:
            return logits
        blocked = blocked_moves(observation, self._gains)
        rest = blocked.new_zeros((*blocked.shape[:-1], logits.shape[-1] - blocked.shape[-1]))
        return logits.masked_fill(torch.cat((blocked, rest), dim=-1), _NEVER)

    def _losses(self, rollout: Experience) -> _Losses:
        """Return the losses of each network; arrays of the rollout are [decisions, envs, robots, ...]."""
        observation = torch.from_numpy(rollout.observation)
        values = self._forward(self.critic, observation)[..., 0]
        with torch.no_grad():
            following = self._forward(self.critic, torch.from_numpy(rollout.final_observation))[..., 0]
        advantages = self._advantages(rollout, values.detach().numpy(), following.numpy())
        returns = torch.from_numpy(advantages) + values.detach()
        # By each robot's own: over all robots, one that earns much would drown the others.
        spread = advantages.std(axis=(0, 1)) + np.float32(1e-8)
        scaled = torch.from_numpy((advantages - advantages.mean(axis=(0, 1))) / spread)
        chances = torch.log_softmax(self._logits(observation), dim=-1)
        taken = chances.gather(-1, torch.from_numpy(rollout.action)[..., None])[..., 0]
        each = (-taken * scaled, (values - returns).square(), -(chances.exp() * chances).sum(dim=-1))
        whole = (0, 1, 2) if self.networks == 1 else (0, 1)
        return _Losses(*(part.mean(dim=whole).reshape(-1) for part in each))

    def _advantages(
        self, rollout: Experience, values: NDArray[np.float32], following: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the advantages of the decisions, [decisions, envs, robots]: GAE within each episode.

        `following` are the values of what each decision led to: where an episode was cut off that still
        counts, where the task ended it does not.
        """
        discount, trace = np.float32(self.config.discount), np.float32(self.config.gae_lambda)
        goes_on = ~rollout.terminated[..., None]
        surprise = (
            np.float32(self.config.reward_scale) * rollout.reward + discount * goes_on * following - values
        )
        linked = discount * trace * ~rollout.ended[..., None]
        advantages = np.empty_like(surprise)
        later = np.zeros_like(surprise[0])
        for decision in reversed(range(len(surprise))):
            later = advantages[decision] = surprise[decision] + linked[decision] * later
        return advantages

    def _clip(self) -> float:
        """Shorten each network's gradient to the norm allowed; returns their mean length before."""
        gradients = [one.grad for one in self._parameters if one.grad is not None]
        squares = torch.stack([gradient.square().sum(dim=(1, 2)) for gradient in gradients])
        norms = squares.sum(dim=0).sqrt()
        factors = (self.config.gradient_norm / (norms + 1e-6)).clamp(max=1.0)
        for gradient in gradients:
            gradient.mul_(factors[:, None, None])
        return float(norms.mean())


class _Losses(NamedTuple):
    """Of each network, [networks]."""

    policy: Tensor
    value: Tensor
    entropy: Tensor


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): one for name, one in tensors.items() if name.startswith(prefix)}
