"""The Q-networks of all robots as one stacked network: a batched matrix product per layer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robosim.control.network import LEAST_SQUARE
from robosim.errors import InputError

CPU = torch.device("cpu")

_threshold_backward = torch.ops.aten.threshold_backward.grad_input


@dataclass(frozen=True, slots=True)
class NetworkShape:
    """Sizes of the layers that every robot's network has."""

    robots: int
    inputs: int
    hidden: tuple[int, ...]
    outputs: int
    normalised: bool = False
    """What a hidden layer puts out is divided by its root mean square, after ReLU (Zhang 2019)."""

    @property
    def layers(self) -> tuple[tuple[int, int], ...]:
        """(inputs, outputs) of each layer."""
        return tuple(pairwise((self.inputs, *self.hidden, self.outputs)))

    @property
    def parameters(self) -> int:
        """Numbers in the stacked network, all robots together."""
        return self.robots * sum((inputs + 1) * outputs for inputs, outputs in self.layers)


class Layers:
    """Weights and biases of some robots' networks, or numbers that belong to each, layer by layer."""

    def __init__(self, weights: list[Tensor], biases: list[Tensor]) -> None:
        self.weights = weights
        """[robots, inputs, outputs] of each layer."""
        self.biases = biases
        """[robots, 1, outputs] of each layer."""

    def part(self, robots: slice) -> Layers:
        """Return views of the layers of those robots."""
        return Layers([weight[robots] for weight in self.weights], [bias[robots] for bias in self.biases])


class Parameters(Layers):
    """The layers of all robots, as views of one flat buffer.

    One buffer lets the optimiser and the target network treat all layers of all robots in one pass.
    """

    def __init__(self, shape: NetworkShape, device: torch.device = CPU) -> None:
        super().__init__([], [])
        self.shape = shape
        self.flat = torch.zeros(shape.parameters, device=device)
        robots, start = shape.robots, 0
        for inputs, outputs in shape.layers:
            middle = start + robots * inputs * outputs
            end = middle + robots * outputs
            self.weights.append(self.flat[start:middle].view(robots, inputs, outputs))
            self.biases.append(self.flat[middle:end].view(robots, 1, outputs))
            start = end
        # The last weight lies in memory as `transposed` says.
        self.weights[-1] = self.weights[-1].view(robots, shape.outputs, -1).mT

    def named(self) -> dict[str, Tensor]:
        """Return views named as in a policy folder: `layer0.weight` [robots, in, out] and so on."""
        views: dict[str, Tensor] = {}
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            views[f"layer{layer}.weight"] = weight
            views[f"layer{layer}.bias"] = bias[:, 0]
        return views

    def to_numpy(self) -> dict[str, NDArray[np.float32]]:
        """Return copies under the names of `named`."""
        return {name: view.cpu().numpy().copy() for name, view in self.named().items()}

    def load(self, arrays: Mapping[str, NDArray[np.float32] | Tensor], first_robot: int = 0) -> None:
        """Copy arrays named and shaped as those of `to_numpy` into the robots from `first_robot` on.

        InputError, and nothing copied, when a name is missing or unknown, or a shape does not fit.
        """
        views = self.named()
        if arrays.keys() != views.keys():
            raise InputError(
                f"the network's arrays are {', '.join(sorted(arrays))}: they must be {', '.join(views)}."
            )
        given = {name: torch.as_tensor(arrays[name]) for name in views}
        robots = (*given["layer0.weight"].shape, 1)[0]
        room = 0 <= first_robot <= self.shape.robots - robots
        for name, view in views.items():
            fits = (robots, *view.shape[1:])
            if given[name].shape != fits or not room:
                raise InputError(
                    f"{name} has the shape {tuple(given[name].shape)}: {fits} is needed, for robots "
                    f"{first_robot} to {first_robot + robots - 1} of {len(view)}."
                )
        for name, view in views.items():
            view[first_robot : first_robot + robots] = given[name]


def initialise(parameters: Parameters, seeds: Sequence[np.random.SeedSequence]) -> None:
    """Draw each robot's parameters from its own seed, uniform in +-1/sqrt(inputs) as torch.nn.Linear does."""
    for robot, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        for weight, bias in zip(parameters.weights, parameters.biases, strict=True):
            bound = weight.shape[1] ** -0.5
            for tensor in (weight[robot], bias[robot]):
                drawn = rng.uniform(-bound, bound, tuple(tensor.shape)).astype(np.float32)
                tensor.copy_(torch.from_numpy(drawn))


class Activations:
    """What the layers put out in a forward pass, in memory reserved once: fresh memory costs page faults.

    With `keep`, for `backward`, every layer has its own; otherwise two pieces of memory serve in turns,
    which leaves more room in the caches.
    """

    def __init__(
        self, shape: NetworkShape, batch: int, device: torch.device = CPU, keep: bool = True
    ) -> None:
        rows, widest = shape.robots * batch, max(shape.hidden, default=0)
        memory = [torch.empty(rows * widest, device=device) for _ in shape.hidden[: None if keep else 2]]
        self.hidden = [
            memory[layer % len(memory)][: rows * width].view(shape.robots, batch, width)
            for layer, width in enumerate(shape.hidden)
        ]
        """[robots, batch, width] of each layer but the last, after its ReLU."""
        self.scales = [
            torch.empty(shape.robots, batch, 1, device=device) for _ in shape.hidden if shape.normalised
        ]
        """[robots, batch, 1] by what each hidden layer was multiplied; empty where nothing is normalised."""
        self.values = transposed(shape.robots, batch, shape.outputs, device)
        """[robots, batch, outputs] of the last layer."""

    def part(self, robots: slice) -> Activations:
        """Return views of what belongs to those robots."""
        part = copy(self)
        part.hidden, part.values = [output[robots] for output in self.hidden], self.values[robots]
        part.scales = [scale[robots] for scale in self.scales]
        return part


def transposed(robots: int, rows: int, columns: int, device: torch.device = CPU) -> Tensor:
    """Return zeros [robots, rows, columns] that lie in memory column by column.

    Action values and their derivatives do, and so does the last layer's weight: with only a few columns,
    its products take half as long in this order.
    """
    return torch.zeros(robots, columns, rows, device=device).mT


def forward(layers: Layers, inputs: Tensor, activations: Activations) -> Tensor:
    """Return action values [robots, batch, outputs] of `inputs` [robots, batch, inputs].

    The result is a buffer of `activations` and holds until the next pass through them.
    """
    scales: Sequence[Tensor | None] = activations.scales or [None] * len(activations.hidden)
    for weight, bias, output, scale in zip(
        layers.weights, layers.biases, activations.hidden, scales, strict=False
    ):
        # A bias added afterwards costs less than `baddbmm`, which first spreads it over the output.
        torch.bmm(inputs, weight, out=output)
        inputs = output.add_(bias).relu_()
        if scale is not None:
            torch.linalg.vector_norm(output, dim=2, keepdim=True, out=scale)
            scale.square_().mul_(1.0 / output.shape[2]).add_(LEAST_SQUARE).rsqrt_()
            output.mul_(scale)
    torch.bmm(layers.weights[-1].mT, inputs.mT, out=activations.values.mT)
    return activations.values.add_(layers.biases[-1])


def backward(
    layers: Layers,
    inputs: Tensor,
    activations: Activations,
    delta: Tensor,
    scratch: Sequence[Tensor],
    gradient: Layers,
) -> None:
    """Fill `gradient` with that of a loss whose derivative by the action values is `delta`.

    `inputs` [robots, batch, inputs] and the `activations`, kept, are the pass to differentiate; `delta` is
    [robots, batch, outputs], `transposed`. `scratch` is memory of the shapes of the hidden layers, as
    `forward` needs it without `keep`.
    """
    hidden, scales = activations.hidden, activations.scales
    torch.bmm(delta.mT, hidden[-1] if hidden else inputs, out=gradient.weights[-1].mT)
    torch.sum(delta, dim=1, keepdim=True, out=gradient.biases[-1])
    for layer in reversed(range(len(hidden))):
        propagated = torch.bmm(delta, layers.weights[layer + 1].mT, out=scratch[layer])
        if scales:
            # What points along the output has no effect: it is divided out again.
            along = torch.linalg.vecdot(propagated, hidden[layer]).unsqueeze(2)
            propagated.addcmul_(hidden[layer], along, value=-1.0 / propagated.shape[2]).mul_(scales[layer])
        # ReLU passes the derivative on where its output is positive.
        delta = _threshold_backward(propagated, hidden[layer], 0.0, grad_input=propagated)
        torch.bmm((hidden[layer - 1] if layer else inputs).mT, delta, out=gradient.weights[layer])
        torch.sum(delta, dim=1, keepdim=True, out=gradient.biases[layer])


class ActionValues:
    """The stacked network for observations in numpy, in any number of environments."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._activations: dict[int, Activations] = {}

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return action values [envs, robots, actions] of `observation` [envs, robots, size]."""
        envs, parameters = len(observation), self._parameters
        device = parameters.flat.device
        if envs not in self._activations:
            self._activations[envs] = Activations(parameters.shape, envs, device, keep=False)
        with torch.inference_mode():
            inputs = torch.from_numpy(observation).to(device).transpose(0, 1).contiguous()
            values = forward(parameters, inputs, self._activations[envs])
            return values.transpose(0, 1).cpu().numpy().copy()
