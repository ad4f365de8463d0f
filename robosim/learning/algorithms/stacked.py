"""Networks of all robots as one stacked network that autograd differentiates, and their optimiser."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.network import LEAST_SQUARE, Normalisation
from robosim.discretise.observation import MoveGains, blocked_moves
from robosim.learning.networks import NetworkShape, Parameters, initialise


class StackedNetworks:
    """Networks of one shape with ReLU, one for each robot or one for all: a batched product a layer.

    `robosim.learning.networks` computes the gradient by hand, which is faster; here it may be that of any
    loss, and `normalisation` any that a policy has.
    """

    def __init__(
        self, shape: NetworkShape, normalisation: Normalisation, seeds: Sequence[np.random.SeedSequence]
    ) -> None:
        """Draw the parameters of each of `shape.robots` networks from a seed of its own."""
        self.shape = shape
        self._normalisation = normalisation
        drawn = Parameters(shape)
        initialise(drawn, seeds)
        self.parameters = [
            tensor.clone(memory_format=torch.contiguous_format).requires_grad_()
            for pair in zip(drawn.weights, drawn.biases, strict=True)
            for tensor in pair
        ]
        """Weights [networks, in, out] and biases [networks, 1, out] by turns."""

    def __call__(self, inputs: Tensor) -> Tensor:
        """Return outputs [robots, rows, outputs] of `inputs` [robots, rows, inputs]."""
        robots, rows, size = inputs.shape
        hidden = inputs.reshape(1, -1, size) if self.shape.robots == 1 else inputs
        *before, weight, bias = self.parameters
        for layer in range(0, len(before), 2):
            hidden = torch.baddbmm(before[layer + 1], hidden, before[layer])
            if self._normalisation == "layer":
                hidden = torch.layer_norm(hidden, hidden.shape[-1:], eps=LEAST_SQUARE)
            hidden = torch.relu(hidden)
            if self._normalisation == "rms":
                hidden = torch.rms_norm(hidden, hidden.shape[-1:], eps=LEAST_SQUARE)
        return torch.baddbmm(bias, hidden, weight).reshape(robots, rows, -1)

    def values(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return outputs [envs, robots, outputs] of `observation` [envs, robots, inputs]."""
        with torch.no_grad():
            return self(by_robot(observation)).transpose(0, 1).numpy().copy()

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

    def load(self, arrays: Mapping[str, NDArray[np.float32]]) -> None:
        """Copy arrays named and shaped as those of `to_numpy`; InputError when they do not fit."""
        given = Parameters(self.shape)
        given.load(arrays)
        named = given.named()
        for name, tensor in self.named().items():
            tensor.copy_(named[name])


def by_robot(array: NDArray[np.float32] | NDArray[np.int64]) -> Tensor:
    """Return `array` [..., robots, size] as a tensor [robots, rows, size], contiguous."""
    rows = torch.from_numpy(np.ascontiguousarray(array)).flatten(0, -3)
    return rows.transpose(0, 1).contiguous()


def mask_blocked(values: Tensor, inputs: Tensor, gains: MoveGains | None) -> Tensor:
    """Return values [..., actions] with minus infinity for moves blocked by what `inputs` [..., size] say.

    `gains` comes from `gain_columns`; None for no mask.
    """
    if gains is None:
        return values
    blocked = blocked_moves(inputs, gains)
    still = blocked.new_zeros((*blocked.shape[:-1], values.shape[-1] - blocked.shape[-1]))
    return values.masked_fill(torch.cat((blocked, still), dim=-1), -torch.inf)


def shorten_each(parameters: Sequence[Tensor], most: float) -> float:
    """Shorten the gradient of each of stacked networks to the norm `most`; return their mean norm before."""
    gradients = [one.grad for one in parameters if one.grad is not None]
    norms = torch.stack([gradient.square().sum(dim=(1, 2)) for gradient in gradients]).sum(dim=0).sqrt()
    factors = (most / (norms + 1e-6)).clamp(max=1.0)
    for gradient in gradients:
        gradient.mul_(factors[:, None, None])
    return float(norms.mean())


def optimiser_state(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Return copies of the parameters of an optimiser and of what it has noted about them."""
    tensors = {}
    for i, one in enumerate(_parameters(optimiser)):
        tensors[f"{i}.parameter"] = one.detach().clone()
        tensors |= {f"{i}.{name}": tensor.clone() for name, tensor in optimiser.state.get(one, {}).items()}
    return tensors


def restore_optimiser(optimiser: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Take back what `optimiser_state` returned; ValueError or KeyError when it does not fit."""
    optimiser.state.clear()
    for i, one in enumerate(_parameters(optimiser)):
        noted = part(tensors, f"{i}.")
        given = noted.pop("parameter")
        if given.shape != one.shape:
            raise ValueError(f"parameter {i} has the shape {tuple(given.shape)}, not {tuple(one.shape)}")
        with torch.no_grad():
            one.copy_(given)
        if noted:
            optimiser.state[one] = {name: tensor.clone() for name, tensor in noted.items()}


def part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names begin with `prefix`, without it."""
    return {name.removeprefix(prefix): one for name, one in tensors.items() if name.startswith(prefix)}


def _parameters(optimiser: torch.optim.Optimizer) -> list[Tensor]:
    return [one for group in optimiser.param_groups for one in group["params"]]
