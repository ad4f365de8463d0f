"""Measure a full update of the stacked Double DQN against its bare matrix products, on one core.

    python tools/bench_learning.py [--seconds 3]

The bare products have the shapes of an update and nothing else: the network on observations and on
successors, the target network on successors, and the gradients. Both are timed in turns in the same
run, so that a busy machine slows both.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import torch

from robosim.learning.dqn import DqnSettings, StackedDoubleDQN
from robosim.learning.networks import NetworkShape


def bare_products(shape: NetworkShape, batch: int) -> Callable[[], None]:
    """Return a function that makes an update's matrix products, into memory reserved before."""
    products: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []
    for layer, (inputs, outputs) in enumerate(shape.layers):
        x, y = torch.randn(shape.robots, batch, inputs), torch.randn(shape.robots, batch, outputs)
        weight = torch.randn(shape.robots, inputs, outputs)
        products += [(x, weight, torch.empty_like(y))] * 3
        products.append((x.transpose(1, 2), y, torch.empty_like(weight)))
        if layer:
            products.append((y, weight.transpose(1, 2), torch.empty_like(x)))

    def run() -> None:
        with torch.inference_mode():
            for left, right, out in products:
                torch.bmm(left, right, out=out)

    return run


def full_update(shape: NetworkShape, batch: int) -> Callable[[], object]:
    """Return the update of a learner whose replay is full."""
    settings = DqnSettings(
        discount=0.99, batch_size=batch, target_interval=500,
        replay_capacity=20_000, reward_scale=0.1,
    )  # fmt: skip
    learner = StackedDoubleDQN(shape, settings, np.random.SeedSequence(0))
    rng = np.random.default_rng(1)
    for _ in range(20):
        observations, successors = rng.random((2, 1000, shape.robots, shape.inputs), np.float32)
        actions = rng.integers(shape.outputs, size=(1000, shape.robots))
        learner.replay.add(observations, actions, rng.random(actions.shape, np.float32), successors)
    return lambda: learner.update(1e-4)


def microseconds(function: Callable[[], object], calls: int) -> float:
    start = time.perf_counter()
    for _ in range(calls):
        function()
    return (time.perf_counter() - start) / calls * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=3.0, help="time for each batch size")
    seconds = parser.parse_args().seconds
    shape = NetworkShape(robots=8, inputs=90, hidden=(128, 128, 128), outputs=5)
    for batch in (64, 512):
        update, products = full_update(shape, batch), bare_products(shape, batch)
        microseconds(update, 10), microseconds(products, 10)
        pairs = []
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            pairs.append((microseconds(update, 10), microseconds(products, 10)))
        full, bare = np.median(pairs, axis=0)
        ratio = float(np.median([one / other for one, other in pairs]))
        print(f"batch {batch:4d}: update {full:7.0f} us, bare products {bare:7.0f} us, ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
