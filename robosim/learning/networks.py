"""The Q-networks of all robots as one stacked network: a batched matrix product per layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True, slots=True)
class NetworkShape:
    """Sizes of the layers that every robot's network has."""

    robots: int
    inputs: int
    hidden: tuple[int, ...]
    outputs: int

    @property
    def layers(self) -> tuple[tuple[int, int], ...]:
        """(inputs, outputs) of each layer."""
        return tuple(pairwise((self.inputs, *self.hidden, self.outputs)))

    @property
    def parameters(self) -> int:
        """Numbers in the stacked network, all robots together."""
        return self.robots * sum((inputs + 1) * outputs for inputs, outputs in self.layers)


class Parameters:
    """Weights and biases of a stacked network, or their gradients, as views of one flat buffer.

    One buffer lets the optimiser and the target network treat all layers of all robots in one pass.
    """

    def __init__(self, shape: NetworkShape) -> None:
        self.shape = shape
        self.flat = torch.zeros(shape.parameters)
        self.weights: list[Tensor] = []
        """[robots, inputs, outputs] of each layer."""
        self.biases: list[Tensor] = []
        """[robots, 1, outputs] of each layer."""
        start = 0
        for inputs, outputs in shape.layers:
            middle = start + shape.robots * inputs * outputs
            end = middle + shape.robots * outputs
            self.weights.append(self.flat[start:middle].view(shape.robots, inputs, outputs))
            self.biases.append(self.flat[middle:end].view(shape.robots, 1, outputs))
            start = end

    def to_numpy(self) -> dict[str, NDArray[np.float32]]:
        """Return copies named as in a policy folder: `layer0.weight` [robots, in, out] and so on."""
        arrays: dict[str, NDArray[np.float32]] = {}
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays[f"layer{layer}.weight"] = weight.numpy().copy()
            arrays[f"layer{layer}.bias"] = bias[:, 0].numpy().copy()
        return arrays


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
    """Buffers for one forward pass of a given batch size, allocated once: fresh ones cost page faults."""

    def __init__(self, shape: NetworkShape, batch: int) -> None:
        self.outputs = [torch.empty(shape.robots, batch, outputs) for _, outputs in shape.layers]
        """[robots, batch, outputs] of each layer, after its ReLU; the last layer has none."""


def forward(parameters: Parameters, inputs: Tensor, activations: Activations) -> Tensor:
    """Return action values [robots, batch, outputs] of `inputs` [robots, batch, inputs].

    The result is a buffer of `activations` and holds until the next pass through them.
    """
    outputs = activations.outputs
    last = len(outputs) - 1
    for layer, output in enumerate(outputs):
        torch.baddbmm(parameters.biases[layer], inputs, parameters.weights[layer], out=output)
        inputs = output if layer == last else output.relu_()
    return inputs


class Backward:
    """Hand-written gradient of the stacked network, into memory reserved once."""

    def __init__(self, shape: NetworkShape, batch: int) -> None:
        self.gradient = Parameters(shape)
        self._deltas = [torch.empty(shape.robots, batch, outputs) for outputs in shape.hidden]

    def __call__(
        self, parameters: Parameters, inputs: Tensor, outputs: Sequence[Tensor], delta: Tensor
    ) -> None:
        """Fill `gradient` with that of a loss whose derivative by the action values is `delta`.

        `inputs` [robots, batch, inputs] and `outputs`, those of every layer, are the pass to differentiate;
        `delta` is [robots, batch, actions].
        """
        for layer in reversed(range(len(outputs))):
            below = outputs[layer - 1] if layer else inputs
            torch.bmm(below.transpose(1, 2), delta, out=self.gradient.weights[layer])
            torch.sum(delta, dim=1, keepdim=True, out=self.gradient.biases[layer])
            if layer:
                propagated = self._deltas[layer - 1]
                torch.bmm(delta, parameters.weights[layer].transpose(1, 2), out=propagated)
                # ReLU passes the derivative on where its output is positive.
                delta = torch.ops.aten.threshold_backward.grad_input(
                    propagated, below, 0.0, grad_input=propagated
                )
