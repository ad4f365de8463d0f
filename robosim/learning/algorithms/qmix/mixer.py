"""Mixers: how the values of the robots' actions make the value of the team's.

They take values [robots, rows] and the states they belong to, [rows, size], and return [rows].
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn


class SumMixer(nn.Module):
    """The sum (VDN, Sunehag 2018)."""

    def forward(self, values: Tensor, state: Tensor) -> Tensor:
        return values.sum(dim=0)


class MonotonicMixer(nn.Module):
    """A network that never falls as a robot's value grows (QMIX, Rashid 2018).

    Its weights are the absolute values of what other networks, the hypernetworks, make of the state: two
    layers each, as in PyMARL2 and EPyMARL. Unlike there, they see the state brought to mean 0 and variance 1.
    The value of a state beyond all that was learned from, such as where an episode is cut off, is then
    bounded; without that, it grew without end where learning looks past the cut-off (docs/validation.md).
    """

    def __init__(
        self, robots: int, state_size: int, width: int, hyper_width: int, seed: np.random.SeedSequence
    ) -> None:
        super().__init__()
        self._robots, self._width = robots, width
        self.weight_in = _network(state_size, hyper_width, robots * width)
        self.bias_in = _linear(state_size, width)
        self.weight_out = _network(state_size, hyper_width, width)
        self.bias_out = _network(state_size, width, 1)
        _draw(self, np.random.default_rng(seed))

    def forward(self, values: Tensor, state: Tensor) -> Tensor:
        state = nn.functional.layer_norm(state, state.shape[-1:])
        weight_in = self.weight_in(state).abs().view(-1, self._robots, self._width)
        hidden = torch.bmm(values.T[:, None], weight_in)[:, 0] + self.bias_in(state)
        mixed = (nn.functional.elu(hidden) * self.weight_out(state).abs()).sum(dim=1)
        team: Tensor = mixed + self.bias_out(state)[:, 0]
        return team


def _network(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(_linear(inputs, hidden), nn.ReLU(), _linear(hidden, outputs))


def _linear(inputs: int, outputs: int) -> nn.Linear:
    # Without torch's own draw, which would come from the generator of the whole process.
    return nn.Linear(inputs, outputs, device="meta").to_empty(device="cpu")


def _draw(module: nn.Module, rng: np.random.Generator) -> None:
    """Draw all layers uniformly in +-1/sqrt(inputs), as torch does."""
    for layer in module.modules():
        if isinstance(layer, nn.Linear):
            bound = layer.in_features**-0.5
            for tensor in (layer.weight, layer.bias):
                drawn = rng.uniform(-bound, bound, tuple(tensor.shape)).astype(np.float32)
                tensor.data.copy_(torch.from_numpy(drawn))
