"""VDN and QMIX as an algorithm of the trainer."""

from __future__ import annotations

import copy

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.learning.algorithms.dqn.replay import Batch
from robosim.learning.algorithms.memory import JointReplay
from robosim.learning.algorithms.protocol import Actors, State, Task
from robosim.learning.algorithms.qmix.config import QmixConfig
from robosim.learning.algorithms.qmix.mixer import MonotonicMixer, SumMixer
from robosim.learning.algorithms.stacked import (
    StackedNetworks,
    mask_blocked,
    optimiser_state,
    part,
    prefixed,
    restore_optimiser,
)
from robosim.learning.algorithms.values import epsilon_greedy
from robosim.learning.computing import denormals_flushed
from robosim.learning.networks import NetworkShape


class Qmix(JointReplay):
    """Robots whose values, mixed, learn from the mean of their rewards; has a `LargeMemory`, its replay.

    The mean, not the sum, so that the team's value is of the same size in a team of any size, that of one
    robot. The state that the mixer sees is what all robots observe, one after another.
    """

    def __init__(
        self, config: QmixConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """Reserve the replay; InputError when it exceeds the memory, or `start` does not fit."""
        networks = 1 if config.shares_parameters else task.robots
        choose, draw, mixer, *each = seed.spawn(3 + networks)
        super().__init__(config, task, choose, draw)
        self.config = config
        self._gains = task.gains if config.mask else None
        shape = NetworkShape(networks, task.size, config.hidden, task.num_actions)
        self.networks = StackedNetworks.draw(shape, each, normalisation=config.normalisation)
        if start is not None:
            self.networks.load(start.weights)
        self.mixer = (
            SumMixer()
            if config.mixer == "sum"
            else MonotonicMixer(
                task.robots, task.robots * task.size, config.mixer_width, config.hyper_width, mixer
            )
        )
        self.target_networks, self.target_mixer = copy.deepcopy((self.networks, self.mixer))
        self._learning = [*self.networks.parameters, *self.mixer.parameters()]
        self._targets = [*self.target_networks.parameters, *self.target_mixer.parameters()]
        self._optimiser = torch.optim.Adam(self._learning, fused=True)
        self._loss = torch.tensor(torch.nan)
        """Of the latest batch."""

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        epsilons = self.config.epsilons_in(self.task, progress, len(observation))
        return epsilon_greedy(
            self._choose, self.networks.values, observation, epsilons, self.task.num_actions, self._gains
        )

    def update(self, progress: float) -> dict[str, float]:
        config = self.config
        rate = config.learning_rate_at(progress)
        self._optimiser.param_groups[0]["lr"] = rate
        with denormals_flushed():
            while self._is_due():
                self._step()
        return {
            "epsilon": self.config.epsilon_in(self.task, progress),
            "learning_rate": rate,
            "loss": self._loss.item(),
        }

    def _step(self) -> None:
        loss = self.loss(self._next_batch())
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self._learning, self.config.gradient_norm)
        self._optimiser.step()
        self._loss = loss.detach()
        if self.updates % self.config.target_interval == 0:
            with torch.no_grad():
                for target, one in zip(self._targets, self._learning, strict=True):
                    target.copy_(one)

    def loss(self, batch: Batch) -> Tensor:
        """Return the mean squared error of the team's values in `batch`, a scalar."""
        chosen = self.networks(batch.observations).gather(2, batch.actions)[..., 0]
        values = self.mixer(chosen, _state(batch.observations))
        with torch.no_grad():
            target = self._target(batch)
        loss: Tensor = (values - target).square().mean()
        return loss

    def _target(self, batch: Batch) -> Tensor:
        """Return what the team's values should be, [rows]: Double-Q (van Hasselt 2016), robot by robot."""
        config, successors = self.config, batch.successors
        values = mask_blocked(self.networks(successors), successors, self._gains)
        best = values.argmax(dim=2, keepdim=True)
        following = self.target_networks(successors).gather(2, best)[..., 0]
        mixed = self.target_mixer(following, _state(successors)) * batch.continues[0, :, 0]
        reward = config.reward_scale * batch.rewards.mean(dim=0)[:, 0]
        target: Tensor = reward + config.discount**config.return_steps * mixed
        return target

    def actors(self) -> Actors:
        return Actors(self.config.value_networks(self.task), self.networks.to_numpy())

    def state(self) -> State:
        tensors, facts = super().state()
        learning = prefixed("optimiser.", optimiser_state(self._optimiser))
        learning |= {f"target.{i}": one.detach().clone() for i, one in enumerate(self._targets)}
        return State({**tensors, **learning, "loss": self._loss.clone()}, facts)

    def restore(self, state: State) -> None:
        super().restore(state)
        restore_optimiser(self._optimiser, part(state.tensors, "optimiser."))
        with torch.no_grad():
            for i, one in enumerate(self._targets):
                one.copy_(state.tensors[f"target.{i}"])
        self._loss = state.tensors["loss"].clone()


def _state(observations: Tensor) -> Tensor:
    """Return what all robots observe, [rows, robots * size], of observations [robots, rows, size]."""
    return observations.transpose(0, 1).flatten(1)
