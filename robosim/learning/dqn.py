"""Independent Double DQN of all robots at once, on stacked networks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.optim.adam import adam

from robosim.learning.networks import Activations, Backward, NetworkShape, Parameters, forward, initialise
from robosim.learning.replay import Replay


@dataclass(frozen=True, slots=True)
class DqnSettings:
    """What an update depends on."""

    discount: float
    """Of the successor's value: to the power of the decisions that an experience spans."""
    batch_size: int
    target_interval: int
    """Updates between two copies of the network into its target network."""
    replay_capacity: int
    """Transitions kept of each robot."""
    reward_scale: float
    """Factor on rewards before learning; it brings action values near 1, where the network starts."""


class StackedDoubleDQN:
    """N learners side by side: own parameters, own experience, own draws; nothing is shared.

    Double DQN (van Hasselt 2016): the network chooses the successor's action, the target network values it.
    Episodes end by truncation only, so every target goes on into the successor.
    """

    def __init__(self, shape: NetworkShape, settings: DqnSettings, seed: np.random.SeedSequence) -> None:
        torch.set_num_threads(1)
        explore, draw, *networks = seed.spawn(2 + shape.robots)
        self.shape = shape
        self.settings = settings
        self.updates = 0
        self.parameters = Parameters(shape)
        initialise(self.parameters, networks)
        self.target = Parameters(shape)
        self.target.flat.copy_(self.parameters.flat)
        self.replay = Replay(shape.robots, settings.replay_capacity, shape.inputs)
        self._explore = np.random.default_rng(explore)
        self._draw = np.random.default_rng(draw)
        batch = settings.batch_size
        self._online = Activations(shape, 2 * batch)
        self._bootstrap = Activations(shape, batch)
        self._backward = Backward(shape, batch)
        self._delta = torch.zeros(shape.robots, batch, shape.outputs)
        self._error = torch.full((shape.robots, batch, 1), torch.nan)
        self._acting: dict[int, Activations] = {}
        self._moments = torch.zeros(2, shape.parameters)
        self._adam_step = torch.zeros(())

    def values(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return action values [envs, robots, actions] of `observation` [envs, robots, size]."""
        envs = len(observation)
        activations = self._acting.setdefault(envs, Activations(self.shape, envs))
        with torch.inference_mode():
            inputs = torch.from_numpy(observation).transpose(0, 1).contiguous()
            return forward(self.parameters, inputs, activations).transpose(0, 1).numpy().copy()

    def act(
        self, observation: NDArray[np.float32], epsilon: float | NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Choose actions [envs, robots]: each robot its best, or with probability `epsilon` any.

        `epsilon` is one number, or [envs, 1].
        """
        shape = observation.shape[:2]
        # Both draws are always made, so that the stream of numbers does not depend on the outcome.
        explores = self._explore.random(shape) < epsilon
        drawn = self._explore.integers(self.shape.outputs, size=shape)
        if explores.all():
            return drawn
        return np.where(explores, drawn, self.values(observation).argmax(axis=-1))

    def update(self, learning_rate: float) -> None:
        """Make one step of Adam on a fresh batch of each robot's own experience."""
        # Moments of unused weights decay into denormals, which slow updates down by a third. It is a
        # setting of the processor, so it goes back before anybody else computes.
        torch.set_flush_denormal(True)
        try:
            with torch.inference_mode():
                self._gradient()
                self._step(learning_rate)
        finally:
            torch.set_flush_denormal(False)
        self.updates += 1
        if self.updates % self.settings.target_interval == 0:
            self.target.flat.copy_(self.parameters.flat)

    def _step(self, learning_rate: float) -> None:
        first, second = self._moments
        adam(
            [self.parameters.flat], [self._backward.gradient.flat], [first], [second], [], [self._adam_step],
            fused=True, amsgrad=False, beta1=0.9, beta2=0.999, lr=learning_rate,
            weight_decay=0.0, eps=1e-8, maximize=False,
        )  # fmt: skip

    def loss(self) -> NDArray[np.float32]:
        """Return the mean squared error of each robot's latest batch, [robots]; NaN before the first."""
        return self._error.square().mean(dim=(1, 2)).numpy()

    def _gradient(self) -> None:
        settings = self.settings
        observations, actions, rewards = self.replay.sample(settings.batch_size, self._draw)
        values = forward(self.parameters, observations, self._online)
        best = values[:, 1::2].argmax(dim=2, keepdim=True)
        bootstrap = forward(self.target, observations[:, 1::2], self._bootstrap).gather(2, best)
        goal = bootstrap.mul_(settings.discount).add_(rewards.unsqueeze(2), alpha=settings.reward_scale)
        error = torch.sub(values[:, 0::2].gather(2, actions), goal, out=self._error)
        self._delta.zero_().scatter_(2, actions, error * (2.0 / settings.batch_size))
        now = [output[:, 0::2] for output in self._online.outputs]
        self._backward(self.parameters, observations[:, 0::2], now, self._delta)
