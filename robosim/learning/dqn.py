"""Independent Double DQN of all robots at once, on stacked networks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.discretise.observation import mask_blocked_moves
from robosim.errors import InputError
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
from robosim.learning.replay import Batch, Replay

Precision = Literal["float32", "bfloat16"]

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
    progress: tuple[int, int] | None = None
    """Where observations tell closed ways (`gain_columns`), which are not chosen; None for no mask."""


class StackedDoubleDQN:
    """N learners side by side: own parameters, own experience, own draws; nothing is shared.

    Double DQN (van Hasselt 2016): the network chooses the successor's action, the target network values it.
    Episodes end by truncation only, so every target goes on into the successor.

    `device` is where parameters and replay lie and updates are computed: "cpu", or "cuda" (or "cuda:1") for
    a GPU; InputError when it is not there. All numbers are drawn on the CPU, the same for every device.

    `precision` "bfloat16" rounds what goes into the matrix products of an update to bfloat16; sums,
    parameters and all the rest stay float32. InputError where there are no units for it.
    """

    def __init__(
        self,
        shape: NetworkShape,
        settings: DqnSettings,
        seed: np.random.SeedSequence,
        device: str = "cpu",
        precision: Precision = "float32",
    ) -> None:
        torch.set_num_threads(1)
        self.device = find_device(device)
        require_precision(precision, self.device)
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
        batch_size = settings.batch_size
        self._gradient = Parameters(shape, self.device)
        self._batch = Batch.reserve(shape.robots, batch_size, shape.inputs, self.device)
        self._error = torch.full((shape.robots, batch_size, 1), torch.nan, device=self.device)
        together = max(1, _BLOCK // batch_size) if self.device == CPU else shape.robots
        self._blocks = list(self._cut(min(together, shape.robots)))
        self._first_moment = Parameters(shape, self.device)
        self._second_moment = Parameters(shape, self.device)
        self._adam_step = torch.zeros((), device=self.device)

    def act(
        self, observation: NDArray[np.float32], epsilon: float | NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Choose actions [envs, robots]: each robot its best that is open, or with probability `epsilon` any.

        `epsilon` is one number, or [envs, 1].
        """
        shape = observation.shape[:2]
        # Both draws are always made, so that the stream of numbers does not depend on the outcome.
        explores = self._explore.random(shape) < epsilon
        drawn = self._explore.integers(self.shape.outputs, size=shape)
        if explores.all():
            return drawn
        values = mask_blocked_moves(self.values(observation), observation, self.settings.progress)
        return np.where(explores, drawn, values.argmax(axis=-1))

    def update(self, learning_rate: float) -> None:
        """Make one step of Adam on a fresh batch of each robot's own experience."""
        settings = self.settings
        with products_in(self.precision), _denormals_flushed(), torch.inference_mode():
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
            self.updates = int(counters["updates"])
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


@dataclass(frozen=True, slots=True)
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
        if settings.progress is not None:
            home, source = (batch.successors[..., first : first + 4] <= -1.0 for first in settings.progress)
            values[..., :4].masked_fill_(home & source, -torch.inf)
        best = values.max(dim=2, keepdim=True).indices
        values = forward(self.online, batch.observations, self.now)
        torch.gather(values, 2, batch.actions, out=error)
        error.sub_(bootstrap.gather(2, best), alpha=settings.discount)
        error.sub_(batch.rewards, alpha=settings.reward_scale)
        self.delta.zero_().scatter_(2, batch.actions, error * (2.0 / settings.batch_size))
        # What the layers made of the successors has served: its memory takes the propagated derivatives.
        scratch = self.after.hidden
        backward(self.online, batch.observations, self.now, self.delta, scratch, self.gradient)


def require_precision(precision: str, device: torch.device) -> None:
    """Raise InputError unless `precision` is float32, or bfloat16 where the device has units for it."""
    if precision not in ("float32", "bfloat16"):
        raise InputError(f"precision is {precision!r}: it must be float32 or bfloat16.")
    if precision == "bfloat16" and not has_bfloat16(device):
        raise InputError("precision is 'bfloat16': this processor has no units for it; float32 always works.")


def has_bfloat16(device: torch.device = CPU) -> bool:
    """Return whether the device has units for products of bfloat16: AMX or AVX-512 BF16, or a GPU's."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    return bool(torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported())


@contextmanager
def products_in(precision: Precision) -> Iterator[None]:
    """Let torch's products of float32 round what goes in to `precision`, until the end of the block."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if precision == "bfloat16" else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@contextmanager
def _denormals_flushed() -> Iterator[None]:
    """Count denormals as zero: moments of unused weights decay into them, and updates cost a third more.

    It is a setting of the processor, so it goes back before anybody else computes.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def find_device(name: str) -> torch.device:
    """Return the torch device of that name; InputError when it is not "cpu" or a GPU that is there."""
    if name != "cpu" and name.partition(":")[0] != "cuda":
        raise InputError(f"device is {name!r}: it must be cpu, or cuda for a GPU.")
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device is {name!r}: torch finds no such GPU here; cpu always works.") from error
    return device
