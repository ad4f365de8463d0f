"""Parallelised Q-network (PQN, Gallici 2025): Q-learning without replay and without target networks.

Many environments run side by side; what they did over a short rollout is learned a few times over, towards
Q(lambda) targets, and forgotten. Layer normalisation keeps that from diverging. With the mixer `sum` it is
value decomposition (VDN, Sunehag 2018): the sum of the robots' values learns from the reward of the team.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from robosim.learning.algorithms.protocol import Actors, Experience, State, Task
from robosim.learning.algorithms.rollout import (
    require_minibatches,
    restored_rollout,
    rollout_state,
    stack_decisions,
)
from robosim.learning.algorithms.settings import StepSize
from robosim.learning.algorithms.stacked import (
    StackedNetworks,
    by_robot,
    mask_blocked,
    optimiser_state,
    part,
    prefixed,
    restore_optimiser,
    shorten_gradients,
)
from robosim.learning.algorithms.values import OwnValuesConfig, epsilon_greedy
from robosim.learning.computing import denormals_flushed
from robosim.learning.networks import NetworkShape


class PqnConfig(OwnValuesConfig):
    """Parallelised Q-network (Gallici 2025)."""

    name: Literal["pqn"] = "pqn"
    """Of the algorithm."""
    mixer: Literal["none", "sum"] = "none"
    """`none`: each robot's value learns from its own reward. `sum`: the sum of the robots' values learns from
    their mean reward (VDN, Sunehag 2018)."""
    normalisation: Literal["none", "rms", "layer"] = "layer"
    """`layer`: hidden layers are brought to mean 0 and variance 1 before ReLU; `rms`: they are divided by
    their root mean square after it."""
    learning_rate: StepSize = 5e-4
    """Step size of RAdam at the start."""
    q_lambda: float = Field(default=0.5, ge=0, le=1)
    """How far targets trust rewards before the network: 0 one decision, 1 to the end of the rollout."""
    rollout: int = Field(default=16, ge=1, le=10_000)
    """Decisions of every environment that are learned from at once."""
    epochs: int = Field(default=4, ge=1, le=1000)
    """How often each rollout is learned from."""
    minibatches: int = Field(default=4, ge=1, le=10_000)
    """Parts of a rollout, drawn anew in each epoch, with a step each."""
    gradient_norm: float = Field(default=1.0, ge=1e-6, le=1e6)
    """Most that the gradient of a network may measure; longer ones are shortened."""

    @property
    def needs_team(self) -> bool:
        return self.mixer != "none"

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> Pqn:
        return Pqn(self, task, seed, start)


class Pqn:
    """Robots that learn by PQN, each its own network or all one, and the rollout they learn from next."""

    def __init__(
        self, config: PqnConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        require_minibatches(config.minibatches, config.rollout * task.num_envs)
        self.config, self.task = config, task
        self._gains = task.gains if config.mask else None
        networks = 1 if config.shares_parameters else task.robots
        explore, shuffle, *each = seed.spawn(2 + networks)
        shape = NetworkShape(networks, task.size, config.hidden, task.num_actions)
        self.networks = StackedNetworks.draw(shape, each, normalisation=config.normalisation)
        if start is not None:
            self.networks.load(start.weights)
        self._optimiser = torch.optim.RAdam(self.networks.parameters, foreach=True)
        self._explore, self._shuffle = np.random.default_rng(explore), np.random.default_rng(shuffle)
        self._rollout: list[Experience] = []

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        epsilons = self.config.epsilons_in(self.task, progress, len(observation))
        return epsilon_greedy(
            self._explore, self.networks.values, observation, epsilons, self.task.num_actions, self._gains
        )

    def observe(self, experience: Experience) -> None:
        self._rollout.append(experience)

    def update(self, progress: float) -> dict[str, float]:
        config = self.config
        if len(self._rollout) < config.rollout:
            return {}
        rollout = stack_decisions(self._rollout)
        self._rollout = []
        rate = config.learning_rate_at(progress)
        self._optimiser.param_groups[0]["lr"] = rate
        observation = by_robot(torch.from_numpy(rollout.observation))
        action = by_robot(torch.from_numpy(rollout.action[..., None]))
        losses, norms = [], []
        with denormals_flushed():
            target = by_robot(torch.from_numpy(self._targets(rollout)[..., None]))[..., 0]
            decisions = observation.shape[1]
            for _ in range(config.epochs):
                order = torch.from_numpy(self._shuffle.permutation(decisions))
                for rows in order.tensor_split(config.minibatches):
                    loss = self.losses(
                        observation.index_select(1, rows),
                        action.index_select(1, rows),
                        target.index_select(1, rows),
                    )
                    self._optimiser.zero_grad()
                    loss.sum().backward()  # type: ignore[no-untyped-call]
                    norms.append(
                        shorten_gradients(self.networks.parameters, config.gradient_norm).mean().item()
                    )
                    self._optimiser.step()
                    losses.append(loss.mean().item())
        return {
            "epsilon": self.config.epsilon_in(self.task, progress),
            "learning_rate": rate,
            "loss": float(np.mean(losses)),
            "gradient_norm": float(np.mean(norms)),
        }

    def losses(self, observation: Tensor, action: Tensor, target: Tensor) -> Tensor:
        """Return half the mean squared error, of each network or of all that is learned together, [networks].

        `observation` is [robots, rows, size], `action` [robots, rows, 1] and `target` [robots, rows], or
        [1, rows] for the team.
        """
        chosen = self.networks(observation).gather(2, action)[..., 0]
        if self.config.mixer == "sum":
            chosen = chosen.sum(dim=0, keepdim=True)
        error = 0.5 * (chosen - target).square().mean(dim=1)
        return error.mean(dim=0, keepdim=True) if self.config.shares_parameters else error

    def _targets(self, rollout: Experience) -> NDArray[np.float32]:
        """Return targets [decisions, envs, robots], or [decisions, envs, 1] for the team."""
        # Decision by decision: what the layers put out then stays in the cache.
        following = np.stack([self._best(observation) for observation in rollout.final_observation])
        reward = rollout.reward
        if self.config.mixer == "sum":
            reward, following = (
                reward.mean(axis=-1, keepdims=True),
                following.sum(axis=-1, keepdims=True),
            )
        scaled = np.float32(self.config.reward_scale) * reward
        return lambda_targets(
            scaled, following, rollout.terminated, rollout.ended, self.config.discount, self.config.q_lambda
        )

    def _best(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the value of each robot's best open action, [envs, robots]."""
        inputs = by_robot(torch.from_numpy(observation))
        with torch.no_grad():
            values = mask_blocked(self.networks(inputs), inputs, self._gains)
            return values.amax(dim=2).T.numpy()

    def actors(self) -> Actors:
        return Actors(self.config.value_networks(self.task), self.networks.to_numpy())

    def state(self) -> State:
        tensors = prefixed("optimiser.", optimiser_state(self._optimiser)) | rollout_state(self._rollout)
        generators = {"explore": self._explore, "shuffle": self._shuffle}
        return State(tensors, {name: rng.bit_generator.state for name, rng in generators.items()})

    def restore(self, state: State) -> None:
        tensors, facts = state
        restore_optimiser(self._optimiser, part(tensors, "optimiser."))
        self._rollout = restored_rollout(tensors)
        self._explore.bit_generator.state = facts["explore"]
        self._shuffle.bit_generator.state = facts["shuffle"]


def lambda_targets(
    reward: NDArray[np.float32],
    following: NDArray[np.float32],
    terminated: NDArray[np.bool_],
    ended: NDArray[np.bool_],
    discount: float,
    trace: float,
) -> NDArray[np.float32]:
    """Return the Q(lambda) targets of a rollout (Peng 1996), of the shape of `reward`.

    `reward` and `following`, the best value of what each decision led to, are [decisions, envs, ...];
    `terminated` and `ended` are [decisions, envs]. The target of a decision is its reward and, discounted,
    the value of what follows: a share `trace` of the next decision's target, the rest `following`. The latter
    alone where an episode was cut off or the rollout ends, nothing where the task ended.
    """
    targets = np.empty_like(reward)
    later = following[-1]
    for decision in reversed(range(len(reward))):
        share = np.float32(trace) * ~ended[decision, :, None]
        value = following[decision] + share * (later - following[decision])
        goes_on = np.float32(discount) * ~terminated[decision, :, None]
        later = targets[decision] = reward[decision] + goes_on * value
    return targets
