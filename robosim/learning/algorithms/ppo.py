"""Proximal policy optimisation (PPO-clip, Schulman 2017), independent or with a critic of the team.

With critics of a robot's own observation this is IPPO (de Witt 2020), with critics that see the observations
of all robots that learn it is MAPPO (Yu 2022). Robots act by their own observation in either.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from robosim.learning.algorithms.actor_critic import (
    ActorCritic,
    Floats,
    Losses,
    OwnActorsConfig,
    advantages,
    log_chances,
    of_networks,
    own_actors,
    standardised,
)
from robosim.learning.algorithms.protocol import Actors, Experience, State, Task
from robosim.learning.algorithms.rollout import require_minibatches
from robosim.learning.algorithms.settings import StepSize
from robosim.learning.algorithms.stacked import by_robot, shorten_gradients
from robosim.learning.networks import NetworkShape

_SCALE_DECAY = 0.95
"""What the statistics of returns keep of themselves from one rollout to the next."""
_LEAST_VARIANCE = 1e-6
"""Of returns, so that ones that are all equal are not blown up."""


class PpoConfig(OwnActorsConfig):
    """Proximal policy optimisation."""

    name: Literal["ppo"] = "ppo"
    """Of the algorithm."""
    rollout: int = Field(default=32, ge=1, le=10_000)
    """Decisions of every environment in an update."""
    learning_rate: StepSize = 3e-3
    """Step size of Adam at the start."""
    entropy_weight: float = Field(default=0.05, ge=0, le=100)
    """Of the entropy of what the actor chooses, which keeps it trying."""
    critic: Literal["own", "team"] = "own"
    """What a critic sees: its robot's observation, or those of all robots that learn."""
    epochs: int = Field(default=4, ge=1, le=1000)
    """How often an update goes through its rollout."""
    minibatches: int = Field(default=4, ge=1, le=10_000)
    """Parts that a rollout is split into, anew in every epoch; each makes a step."""
    clip: float = Field(default=0.2, ge=1e-6, le=100)
    """How far the chance of an action may move from what it was, as a share, and still be rewarded."""
    value_clip: float = Field(default=0.2, ge=0, le=1e6)
    """The same for what a critic puts out, as a difference; 0 for no limit."""
    huber: float = Field(default=10.0, ge=0, le=1e6)
    """Error of a critic from which on its loss grows linearly, no longer as half the square; 0 for never."""
    value_normalisation: bool = True
    """Critics predict returns less their running mean over their running deviation, those of each network."""

    @property
    def needs_team(self) -> bool:
        return self.critic == "team"

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> Ppo:
        return Ppo(self, task, seed, start)


class Ppo(ActorCritic):
    """Actors and critics of the robots that learn, some epochs of gradient steps for each rollout."""

    config: PpoConfig

    def __init__(
        self, config: PpoConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """`start` gives the actors; critics always begin anew."""
        require_minibatches(config.minibatches, config.rollout * task.num_envs)
        spec, team = own_actors(config, task), task.robots * task.size
        # A critic that all share must be told whose return it predicts: that robot's observation comes first.
        # A number would do too, but would take equal robots for different ones.
        apart = {"own": task.size, "team": team + task.size if config.shares_parameters else team}
        critic = NetworkShape(spec.networks, apart[config.critic], config.hidden, 1)
        super().__init__(config, task, seed, start, spec, critic)
        self.scale = ReturnScale(self.networks)

    def state(self) -> State:
        tensors, facts = super().state()
        return State({**tensors, "scale": torch.from_numpy(self.scale.sums.copy())}, facts)

    def restore(self, state: State) -> None:
        super().restore(state)
        self.scale.sums[...] = state.tensors["scale"].numpy()

    def _values(self, observation: Tensor) -> Tensor:
        team = observation.flatten(-2).unsqueeze(-2)
        if self.config.critic == "own":
            return self.critic.of_robots(observation)[..., 0]
        if not self.config.shares_parameters:
            return self.critic.of_robots(team.expand(*observation.shape[:-1], -1))[..., 0]
        # What the first layer makes of the team is the same for all its robots: it is computed once.
        weight, bias, *_ = self.critic.parameters
        own, everybody = weight[:, : self.task.size], weight[0, self.task.size :]
        each = by_robot(observation)
        robots, rows, size = each.shape
        first = torch.baddbmm(bias, each.reshape(1, -1, size), own).reshape(robots, rows, -1)
        sums = first + (team @ everybody).flatten(0, -2)
        values = self.critic.from_first(sums.flatten(0, 1)[None]).reshape(robots, rows)
        return values.T.reshape(observation.shape[:-1])

    def _learn(self, rollout: Experience) -> dict[str, float]:
        batch = self._prepared(rollout)
        figures = []
        for part in self._minibatches(batch):
            losses, clipped = self._losses(part)
            self._descend(losses)
            norms = [
                shorten_gradients(networks.parameters, self.config.gradient_norm)
                for networks in (self.actor, self.critic)
            ]
            self._adam.step()
            figures.append((*(one.detach().mean() for one in losses), clipped, torch.stack(norms).mean()))
        names = ("policy_loss", "value_loss", "entropy", "clipped", "gradient_norm")
        means = torch.tensor(figures).mean(dim=0).tolist()
        return dict(zip(names, means, strict=True))

    def _prepared(self, rollout: Experience) -> Batch:
        """Return what there is to learn from a rollout [decisions, envs, ...] of the present networks."""
        observation, action = torch.from_numpy(rollout.observation), torch.from_numpy(rollout.action)
        with torch.no_grad():
            chance, _ = log_chances(self._logits(observation), action)
            predicted = self._values(observation)
            following = self._values(torch.from_numpy(rollout.final_observation)).numpy()
        values = predicted.numpy()
        if self.config.value_normalisation:
            # By the statistics that the critics learned with; only then may these move.
            values, following = self.scale.widened(values), self.scale.widened(following)
        gained = advantages(self.config, rollout, values, following)
        target = gained + values
        if self.config.value_normalisation:
            self.scale.add(target)
            target = self.scale.narrowed(target)
        scaled = standardised(gained, self.networks)
        rows = (observation, action, chance, torch.from_numpy(scaled), torch.from_numpy(target), predicted)
        return Batch(*(part.flatten(0, 1) for part in rows))

    def _minibatches(self, batch: Batch) -> Iterator[Batch]:
        """Yield the parts of all epochs; a decision of an environment keeps its robots together."""
        for _ in range(self.config.epochs):
            order = torch.from_numpy(self._rng.permutation(len(batch.action)))
            for rows in order.tensor_split(self.config.minibatches):
                yield Batch(*(part.index_select(0, rows) for part in batch))

    def _losses(self, batch: Batch) -> tuple[Losses, Tensor]:
        """Return the losses of each network, and the share of decisions whose ratio is beyond the clip."""
        config = self.config
        chance, entropy = log_chances(self._logits(batch.observation), batch.action)
        ratio = (chance - batch.chance).exp()
        within = ratio.clamp(1.0 - config.clip, 1.0 + config.clip)
        policy = -torch.minimum(ratio * batch.advantage, within * batch.advantage)
        values = self._values(batch.observation)
        error = self._error(values - batch.target)
        if config.value_clip > 0.0:
            near = batch.predicted + (values - batch.predicted).clamp(-config.value_clip, config.value_clip)
            error = torch.maximum(error, self._error(near - batch.target))
        return of_networks(self.networks, (policy, error, entropy)), (ratio != within).float().mean()

    def _error(self, difference: Tensor) -> Tensor:
        """Return the loss of a critic that is off by so much."""
        square, huber = 0.5 * difference.square(), self.config.huber
        if huber == 0.0:
            return square
        size = difference.abs()
        return torch.where(size <= huber, square, huber * (size - 0.5 * huber))


class Batch(NamedTuple):
    """Decisions of environments to learn from, [decisions, robots, ...]."""

    observation: Tensor
    action: Tensor
    chance: Tensor
    """Logarithm of the action's, by the policy that chose it."""
    advantage: Tensor
    """Over their deviation."""
    target: Tensor
    """What the critics ought to put out."""
    predicted: Tensor
    """What they put out before the update."""


class ReturnScale:
    """Running mean and deviation of the returns of each network, the units its critic predicts in (Yu 2022).

    Rollouts count less the longer ago they were. Before the first one the units are those of the returns.
    """

    def __init__(self, networks: int) -> None:
        self.sums: NDArray[np.float64] = np.zeros((3, networks))
        """Of weights, returns and squares of returns, [3, networks]."""

    def add(self, returns: Floats) -> None:
        """Take in the returns of a rollout, [decisions, envs, robots]."""
        axes = (0, 1, 2) if self.sums.shape[1] == 1 else (0, 1)
        wide = returns.astype(np.float64)
        means = (np.ones(self.sums.shape[1]), wide.mean(axis=axes), np.square(wide).mean(axis=axes))
        for total, mean in zip(self.sums, means, strict=True):
            total *= _SCALE_DECAY
            total += (1.0 - _SCALE_DECAY) * mean

    def narrowed(self, returns: Floats) -> Floats:
        """Return returns [..., robots] in the units of the critics."""
        mean, deviation = self._moments()
        return ((returns - mean) / deviation).astype(np.float32)

    def widened(self, predicted: Floats) -> Floats:
        """Return what critics put out [..., robots] as returns."""
        mean, deviation = self._moments()
        return (predicted * deviation + mean).astype(np.float32)

    def _moments(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        weight, total, squares = self.sums
        if not weight.any():
            return np.zeros_like(total), np.ones_like(total)
        mean = total / weight
        return mean, np.sqrt(np.maximum(squares / weight - np.square(mean), _LEAST_VARIANCE))
