"""Independent Double DQN of all robots at once, on stacked networks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.card import MOST
from robosim.discretise.observation import MoveGains, blocked_moves
from robosim.errors import InputError, whole_number
from robosim.learning.algorithms.dqn.replay import Batch, Replay
from robosim.learning.algorithms.values import epsilon_greedy
from robosim.learning.computing import denormals_flushed, find_device
from robosim.learning.networks import (
    CPU,
    ActionValues,
    Activations,
    Layers,
    NetworkShape,
    Parameters,
    backward,
    forward,
    initialise,
    transposed,
)
from robosim.learning.precision import Precision, products_in, require_precision

_BLOCK = 1024
"""Rows, robots times batch, that an update takes through the networks together on the CPU: what the
layers put out then stays in the second-level cache until the next layer and the gradient need it."""


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
    gains: MoveGains | None = None
    """Where observations hold the gains of moves (`gain_columns`), of which blocked ones are not chosen; None
    for no mask."""


class StackedDoubleDQN:
    """N learners side by side: own parameters, own experience, own draws; nothing is shared.

    Double DQN (van Hasselt 2016): the network chooses the successor's action, the target network values it.
    A target goes on into the successor unless the task ended with it. Whoever uses it sets the threads of
    torch (`one_thread`).

    `device` is where parameters and replay lie and updates are computed: "cpu", or "cuda" (or "cuda:1") for
    a GPU; InputError when it is not there. All numbers are drawn on the CPU, the same for every device.

    `precision` "bfloat16" rounds what goes into the matrix products of an update to bfloat16; sums,
    parameters and all the rest stay float32. InputError where torch rounds none of them.
    """

    def __init__(
        self,
        shape: NetworkShape,
        settings: DqnSettings,
        seed: np.random.SeedSequence,
        device: str = "cpu",
        precision: Precision = "float32",
    ) -> None:
        self.device = find_device(device)
        batch_size = settings.batch_size
        together = max(1, _BLOCK // batch_size) if self.device == CPU else shape.robots
        together = min(together, shape.robots)
        require_precision(precision, replace(shape, robots=together), batch_size, self.device)
        self.precision = precision
        explore, draw, *networks = seed.spawn(2 + shape.robots)
        self.shape = shape
        self.settings = settings
        self.updates = 0
        self.parameters = Parameters(shape, self.device)
        initialise(self.parameters, networks)
        self.target = Parameters(shape, self.device)
        self.target.flat.copy_(self.parameters.flat)
        self.replay = Replay(shape.robots, settings.replay_capacity, shape.inputs, self.device)
        self._explore = np.random.default_rng(explore)
        self._draw = np.random.default_rng(draw)
        self.values = ActionValues(self.parameters)
        """Action values [envs, robots, actions] of observations [envs, robots, size]."""
        self._gradient = Parameters(shape, self.device)
        self._batch = Batch.reserve(shape.robots, batch_size, shape.inputs, self.device)
        self._error = torch.full((shape.robots, batch_size, 1), torch.nan, device=self.device)
        self._blocks = list(self._cut(together))
        self._first_moment = Parameters(shape, self.device)
        self._second_moment = Parameters(shape, self.device)
        self._adam_step = torch.zeros((), device=self.device)

    def act(
        self, observation: NDArray[np.float32], epsilon: float | NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Choose actions [envs, robots]: each robot its best that is open, or with probability `epsilon` any.

        `epsilon` is one number, or [envs, 1].
        """
        return epsilon_greedy(
            self._explore, self.values, observation, epsilon, self.shape.outputs, self.settings.gains
        )

    def update(self, learning_rate: float) -> None:
        """Make one step of Adam on a fresh batch of each robot's own experience."""
        settings = self.settings
        with products_in(self.precision), denormals_flushed(), torch.inference_mode():
            self.replay.sample(self._draw, self._batch)
            for block in self._blocks:
                block.fill_gradient(settings)
            self._step(learning_rate)
        self.updates += 1
        if self.updates % settings.target_interval == 0:
            self.target.flat.copy_(self.parameters.flat)

    def _step(self, learning_rate: float) -> None:
        self._adam_step.add_(1)
        # What `torch.optim.adam` calls in the end; its other checks cost as much as a product.
        torch._fused_adam_(
            [self.parameters.flat], [self._gradient.flat],
            [self._first_moment.flat], [self._second_moment.flat], [], [self._adam_step],
            lr=learning_rate, beta1=0.9, beta2=0.999, eps=1e-8,
            weight_decay=0.0, amsgrad=False, maximize=False,
        )  # fmt: skip

    def loss(self) -> NDArray[np.float32]:
        """Return the mean squared error of each robot's latest batch, [robots]; NaN before the first."""
        return self._error.square().mean(dim=(1, 2)).cpu().numpy()

    def load_parameters(self, arrays: Mapping[str, NDArray[np.float32]], first_robot: int = 0) -> None:
        """Give the robots from `first_robot` on the parameters of a policy, in network and target network.

        `arrays` are named and shaped as in a policy folder; InputError when they do not fit.
        """
        self.parameters.load(arrays, first_robot)
        self.target.load(arrays, first_robot)

    def state(self) -> dict[str, Tensor]:
        """Return copies, on the CPU, of the tensors of which the learner goes on, except the replay's.

        With `counters` and the replay's transitions, `restore` makes of them a learner that goes on in the
        same bits: `online.layer0.weight` and so on, the same of `target`, `moment1` and `moment2`, Adam's
        `step`, and `error`, that of the latest batch [robots, batch, 1].
        """
        tensors = {
            f"{part}.{name}": view
            for part, parameters in self._stateful().items()
            for name, view in parameters.named().items()
        }
        tensors |= {"step": self._adam_step, "error": self._error}
        return {name: tensor.to(CPU, copy=True).contiguous() for name, tensor in tensors.items()}

    def counters(self) -> dict[str, Any]:
        """Return what belongs to `state` and is no tensor, fit for JSON: `updates`, `explore` and `draw`.

        The last two are the states of the generators.
        """
        return {
            "updates": self.updates,
            "explore": self._explore.bit_generator.state,
            "draw": self._draw.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Tensor], counters: Mapping[str, Any]) -> None:
        """Take back what `state` and `counters` returned; InputError when it does not fit this learner."""
        parts = self._stateful()
        for tensor, name in ((self._adam_step, "step"), (self._error, "error")):
            if name not in state or state[name].shape != tensor.shape:
                raise InputError(f"the learner's state has no {name} of shape {tuple(tensor.shape)}.")
        for part, parameters in parts.items():
            prefix = f"{part}."
            parameters.load({n.removeprefix(prefix): t for n, t in state.items() if n.startswith(prefix)})
        self._adam_step.copy_(state["step"])
        self._error.copy_(state["error"])
        try:
            self.updates = whole_number("updates", counters["updates"], 0, MOST)
            self._explore.bit_generator.state = counters["explore"]
            self._draw.bit_generator.state = counters["draw"]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"the learner's counters are not those of a checkpoint: {error}.") from error

    def _stateful(self) -> dict[str, Parameters]:
        return {
            "online": self.parameters,
            "target": self.target,
            "moment1": self._first_moment,
            "moment2": self._second_moment,
        }

    def _cut(self, together: int) -> Iterator[_Block]:
        """Yield blocks of at most so many robots; they use the same scratch memory one after another."""
        shape, batch_size = replace(self.shape, robots=together), self.settings.batch_size
        now = Activations(shape, batch_size, self.device)
        after = Activations(shape, batch_size, self.device, keep=False)
        delta = transposed(together, batch_size, shape.outputs, self.device)
        for first in range(0, self.shape.robots, together):
            robots = slice(first, first + together)
            own = slice(0, self.shape.robots - first)
            yield _Block(
                self.parameters.part(robots),
                self.target.part(robots),
                self._gradient.part(robots),
                self._batch.part(robots),
                self._error[robots],
                now.part(own),
                after.part(own),
                delta[own],
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """What an update reads and writes of some robots: views, made once."""

    online: Layers
    target: Layers
    gradient: Layers
    batch: Batch
    error: Tensor
    now: Activations
    """Of the network on the observations."""
    after: Activations
    """Of either network on the successors."""
    delta: Tensor

    def fill_gradient(self, settings: DqnSettings) -> None:
        """Set `error` and `gradient` to those of the batch."""
        batch, error = self.batch, self.error
        # The target network goes first: the other's parameters then stay in the cache up to the gradient.
        bootstrap = forward(self.target, batch.successors, self.after).clone()
        values = forward(self.online, batch.successors, self.after)
        if settings.gains is not None:
            blocked = blocked_moves(batch.successors, settings.gains)
            values[..., : settings.gains.moves].masked_fill_(blocked, -torch.inf)
        best = values.max(dim=2, keepdim=True).indices
        values = forward(self.online, batch.observations, self.now)
        torch.gather(values, 2, batch.actions, out=error)
        error.sub_(bootstrap.gather(2, best).mul_(batch.continues), alpha=settings.discount)
        error.sub_(batch.rewards, alpha=settings.reward_scale)
        self.delta.zero_().scatter_(2, batch.actions, error * (2.0 / settings.batch_size))
        # What the layers made of the successors has served: its memory takes the propagated derivatives.
        scratch = self.after.hidden
        backward(self.online, batch.observations, self.now, self.delta, scratch, self.gradient)
