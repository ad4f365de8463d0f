"""VDN and QMIX as an algorithm of the trainer."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.network import NetworkSpec
from robosim.errors import InputError
from robosim.learning.algorithms.dqn.replay import Batch, Replay
from robosim.learning.algorithms.dqn.returns import MultiStepReturns
from robosim.learning.algorithms.protocol import Actors, Experience, State, Task
from robosim.learning.algorithms.qmix.config import QmixConfig
from robosim.learning.algorithms.qmix.mixer import MonotonicMixer, SumMixer
from robosim.learning.algorithms.stacked import (
    StackedNetworks,
    mask_blocked,
    optimiser_state,
    part,
    restore_optimiser,
)
from robosim.learning.algorithms.values import epsilon_greedy
from robosim.learning.computing import denormals_flushed
from robosim.learning.networks import NetworkShape


class Qmix:
    """Robots whose values, mixed, learn from the mean of their rewards; has a `LargeMemory`, its replay.

    The mean, not the sum, so that the team's value is of the same size in a team of any size, that of one
    robot. The state that the mixer sees is what all robots observe, one after another.
    """

    def __init__(
        self, config: QmixConfig, task: Task, seed: np.random.SeedSequence, start: Actors | None = None
    ) -> None:
        """Reserve the replay; InputError when it exceeds the memory, or `start` does not fit."""
        self.config, self.task = config, task
        self._gains = task.gains if config.mask else None
        networks = 1 if config.shares_parameters else task.robots
        explore, draw, mixer, *each = seed.spawn(3 + networks)
        self._explore, self._draw = np.random.default_rng(explore), np.random.default_rng(draw)
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
        try:
            self.replay = Replay(task.robots, config.capacity(task), task.size)
        except (RuntimeError, MemoryError) as error:
            raise InputError(
                f"replay_capacity is {config.replay_capacity}, but must be less: {task.robots} robots with "
                f"observations of {task.size} numbers need more memory than there is."
            ) from error
        self._batch = Batch.reserve(task.robots, config.batch_size, task.size)
        self._returns = MultiStepReturns(config.return_steps, config.discount)
        self._decisions = 0
        """Joint decisions observed."""
        self.updates = 0
        self._loss = torch.tensor(torch.nan)
        """Of the latest batch."""

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        epsilons = self.config.epsilons(self._epsilon(progress), len(observation))[:, None]
        return epsilon_greedy(
            self._explore, self.networks.values, observation, epsilons, self.task.num_actions, self._gains
        )

    def observe(self, experience: Experience) -> None:
        self._decisions += len(experience.reward)
        complete = self._returns.add(experience)
        if complete is not None:
            self.replay.add(*complete)

    def update(self, progress: float) -> dict[str, float]:
        config = self.config
        rate = config.learning_rate_at(progress)
        self._optimiser.param_groups[0]["lr"] = rate
        due = config.updates_due(self._decisions)
        with denormals_flushed():
            while self.replay.length and self.updates < due:
                self._step()
        return {"epsilon": self._epsilon(progress), "learning_rate": rate, "loss": self._loss.item()}

    def _step(self) -> None:
        # The same moments of all robots: the mixer needs the whole team.
        self.replay.sample(self._draw, self._batch, together=True)
        loss = self.loss(self._batch)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self._learning, self.config.gradient_norm)
        self._optimiser.step()
        self._loss = loss.detach()
        self.updates += 1
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
        config, task = self.config, self.task
        spec = NetworkSpec(
            inputs=task.size,
            hidden=config.hidden,
            normalisation=config.normalisation,
            mask=self._gains is not None,
            output="action values",
            actions=task.num_actions,
            of_robot=(0,) * task.robots if config.shares_parameters else tuple(range(task.robots)),
        )
        return Actors(spec, self.networks.to_numpy())

    def state(self) -> State:
        tensors = {f"optimiser.{name}": one for name, one in optimiser_state(self._optimiser).items()}
        tensors |= {f"target.{i}": one.detach().clone() for i, one in enumerate(self._targets)}
        tensors |= {f"open.{name}": torch.from_numpy(a) for name, a in self._returns.state().items()}
        tensors["loss"] = self._loss.clone()
        facts = {
            "decisions": self._decisions,
            "updates": self.updates,
            "explore": self._explore.bit_generator.state,
            "draw": self._draw.bit_generator.state,
        }
        return State(tensors, facts)

    def restore(self, state: State) -> None:
        tensors, facts = state
        restore_optimiser(self._optimiser, part(tensors, "optimiser."))
        with torch.no_grad():
            for i, one in enumerate(self._targets):
                one.copy_(tensors[f"target.{i}"])
        self._returns.restore({name: one.numpy() for name, one in part(tensors, "open.").items()})
        self._loss = tensors["loss"].clone()
        self._decisions, self.updates = int(facts["decisions"]), int(facts["updates"])
        self._explore.bit_generator.state = facts["explore"]
        self._draw.bit_generator.state = facts["draw"]

    def held(self) -> tuple[int, int]:
        return self.replay.added - self.replay.length, self.replay.added

    def export(self, first: int, last: int) -> dict[str, Tensor]:
        return self.replay.export(first, last)

    def recall(self, first: int, parts: Iterable[Mapping[str, Tensor]]) -> None:
        self.replay.restore(first, parts)

    def _epsilon(self, progress: float) -> float:
        return self.config.epsilon(progress) if self.task.explores else self.config.epsilon_end


def _state(observations: Tensor) -> Tensor:
    """Return what all robots observe, [rows, robots * size], of observations [robots, rows, size]."""
    return observations.transpose(0, 1).flatten(1)
