"""Networks of all robots as one stacked network that autograd differentiates, and their optimiser."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.network import LEAST_SQUARE, Activation, Normalisation
from robosim.discretise.observation import MoveGains, blocked_moves
from robosim.errors import InputError
from robosim.learning.networks import CPU, NetworkShape, Parameters, initialise


class StackedNetworks:
    """Networks of one shape, one for each robot or one for all: a batched product a layer.

    `robosim.learning.networks` computes the gradient by hand, which is faster; here it may be that of any
    loss, and `activation` and `normalisation` any that a policy has.
    """

    def __init__(
        self, start: Parameters, activation: Activation = "relu", normalisation: Normalisation = "none"
    ) -> None:
        """Learn in the memory of `start`."""
        self.shape = start.shape
        self._activation, self._normalisation = activation, normalisation
        pairs = zip(start.weights, start.biases, strict=True)
        self.parameters = [tensor.detach().requires_grad_() for pair in pairs for tensor in pair]
        """Weights [networks, in, out] and biases [networks, 1, out] by turns."""

    @classmethod
    def draw(
        cls,
        shape: NetworkShape,
        seeds: Sequence[np.random.SeedSequence],
        activation: Activation = "relu",
        normalisation: Normalisation = "none",
    ) -> Self:
        """Return networks of which each of `shape.robots` is drawn from a seed of its own."""
        start = Parameters(shape)
        initialise(start, seeds)
        start.weights, start.biases = (
            [tensor.clone(memory_format=torch.contiguous_format) for tensor in tensors]
            for tensors in (start.weights, start.biases)
        )
        return cls(start, activation, normalisation)

    def __call__(self, inputs: Tensor) -> Tensor:
        """Return outputs [robots, rows, outputs] of `inputs` [robots, rows, inputs]."""
        robots, rows, size = inputs.shape
        weight, bias = self.parameters[:2]
        each = inputs.reshape(1, -1, size) if self.shape.robots == 1 else inputs
        return self.from_first(torch.baddbmm(bias, each, weight)).reshape(robots, rows, -1)

    def from_first(self, sums: Tensor) -> Tensor:
        """Return outputs [networks, rows, outputs] where the first layer, its bias included, makes `sums`."""
        for weight, bias in zip(self.parameters[2::2], self.parameters[3::2], strict=True):
            sums = torch.baddbmm(bias, self._activated(sums), weight)
        return sums

    def of_robots(self, observation: Tensor) -> Tensor:
        """Return outputs [..., robots, outputs] of `observation` [..., robots, inputs]."""
        return self(by_robot(observation)).transpose(0, 1).reshape(*observation.shape[:-1], -1)

    def values(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return outputs [envs, robots, outputs] of `observation` [envs, robots, inputs]."""
        with torch.no_grad():
            return self.of_robots(torch.from_numpy(np.ascontiguousarray(observation))).numpy()

    def named(self) -> dict[str, Tensor]:
        """Return the parameters named and shaped as in a policy folder, without their history."""
        named = {}
        for number, (weight, bias) in enumerate(
            zip(self.parameters[::2], self.parameters[1::2], strict=True)
        ):
            named[f"layer{number}.weight"] = weight.detach()
            named[f"layer{number}.bias"] = bias.detach()[:, 0]
        return named

    def to_numpy(self) -> dict[str, NDArray[np.float32]]:
        """Return copies under the names of `named`."""
        return {name: tensor.numpy().copy() for name, tensor in self.named().items()}

    def load(self, arrays: Mapping[str, NDArray[np.float32] | Tensor]) -> None:
        """Copy arrays named and shaped as those of `to_numpy`; InputError when they do not fit."""
        given = Parameters(self.shape)
        given.load(arrays)
        named = given.named()
        for name, tensor in self.named().items():
            tensor.copy_(named[name])

    def _activated(self, sums: Tensor) -> Tensor:
        """Return what a hidden layer makes of its sums."""
        if self._normalisation == "layer":
            sums = torch.layer_norm(sums, sums.shape[-1:], eps=LEAST_SQUARE)
        hidden = torch.tanh(sums) if self._activation == "tanh" else torch.relu(sums)
        if self._normalisation == "rms":
            hidden = torch.rms_norm(hidden, hidden.shape[-1:], eps=LEAST_SQUARE)
        return hidden


def by_robot(tensor: Tensor) -> Tensor:
    """Return `tensor` [..., robots, size] as [robots, rows, size], contiguous."""
    return tensor.flatten(0, -3).transpose(0, 1).contiguous()


def mask_blocked(
    values: Tensor, inputs: Tensor, gains: MoveGains | None, never: float = -torch.inf
) -> Tensor:
    """Return values [..., actions] with `never` for moves blocked by what `inputs` [..., size] say.

    `gains` comes from `gain_columns`; None for no mask.
    """
    if gains is None:
        return values
    blocked = blocked_moves(inputs, gains)
    still = blocked.new_zeros((*blocked.shape[:-1], values.shape[-1] - blocked.shape[-1]))
    return values.masked_fill(torch.cat((blocked, still), dim=-1), never)


def shorten_gradients(parameters: Sequence[Tensor], most: float) -> Tensor:
    """Shorten the gradient of each network, over all of `parameters` [networks, ...], to `most`.

    Returns the lengths before, [networks].
    """
    gradients = [one.grad for one in parameters if one.grad is not None]
    norms = torch.stack([gradient.square().sum(dim=(1, 2)) for gradient in gradients]).sum(dim=0).sqrt()
    factors = (most / (norms + 1e-6)).clamp(max=1.0)
    for gradient in gradients:
        gradient.mul_(factors[:, None, None])
    return norms


def optimiser_state(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Return copies, on the CPU, of the parameters of an optimiser and of what it has noted about them."""
    tensors: dict[str, Tensor] = {}
    for i, one in enumerate(_parameters(optimiser)):
        noted = {"parameter": one.detach(), **optimiser.state.get(one, {})}
        tensors |= {f"{i}.{name}": tensor.to(CPU, copy=True) for name, tensor in noted.items()}
    return tensors


def restore_optimiser(optimiser: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Take back what `optimiser_state` returned; InputError when it belongs to networks of other shapes."""
    optimiser.state.clear()
    for i, one in enumerate(_parameters(optimiser)):
        noted = part(tensors, f"{i}.")
        given = noted.pop("parameter")
        if given.shape != one.shape:
            raise InputError(
                f"a layer of the checkpoint has the shape {tuple(given.shape)}, but must have "
                f"{tuple(one.shape)}."
            )
        with torch.no_grad():
            one.copy_(given)
        if noted:
            optimiser.state[one] = {name: tensor.to(one.device, copy=True) for name, tensor in noted.items()}


def part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names begin with `prefix`, without it."""
    return {name.removeprefix(prefix): one for name, one in tensors.items() if name.startswith(prefix)}


def prefixed(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return tensors under names of which `part` finds them again."""
    return {prefix + name: one for name, one in tensors.items()}


def _parameters(optimiser: torch.optim.Optimizer) -> list[Tensor]:
    return [one for group in optimiser.param_groups for one in group["params"]]
