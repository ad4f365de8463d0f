"""What the matrix products of an update round to, found out by products: a processor's flags do not say it.

torch may round what goes into products of float32 where it is allowed to, and decides that by processor,
size and layout. With AVX-512 BF16 but without AMX, for one, it only adds up in another order.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Literal

import torch
from torch import Tensor

from robosim.errors import InputError, shown
from robosim.learning.networks import CPU, Activations, NetworkShape, Parameters, transposed

Precision = Literal["float32", "bfloat16"]

_BETWEEN = 1.0 + 2.0**-9
"""Lies between two numbers of bfloat16, and is rounded to 1; tf32 and float32 hold it."""


def require_precision(
    precision: str, shape: NetworkShape, batch_size: int, device: torch.device = CPU
) -> None:
    """Raise InputError unless `precision` is float32, or bfloat16 where `rounds_to_bfloat16`."""
    if precision not in ("float32", "bfloat16"):
        raise InputError(f"precision is {shown(precision)}, but must be float32 or bfloat16.")
    if precision == "bfloat16" and not rounds_to_bfloat16(shape, batch_size, device):
        raise InputError(
            'precision is "bfloat16", but must be float32 here: on this machine, torch rounds no product of '
            "an update of this size to bfloat16."
        )


@cache
def rounds_to_bfloat16(shape: NetworkShape, batch_size: int, device: torch.device = CPU) -> bool:
    """Return whether any product of an update of such networks is rounded, as `products_in` allows."""
    with products_in("bfloat16"), torch.inference_mode():
        return any(_is_rounded(left, right) for left, right in _products(shape, batch_size, device))


@contextmanager
def products_in(precision: Precision) -> Iterator[None]:
    """Let torch's products of float32 round what goes in to `precision`, until the end of the block.

    It is a permission: whether anything is rounded, `rounds_to_bfloat16` finds out.
    """
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if precision == "bfloat16" else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def _is_rounded(left: Tensor, right: Tensor) -> bool:
    """Return whether both operands of a product are rounded; overwrites them.

    All sums are exact in float32, in any order, so the result shows which numbers were multiplied.
    """
    terms = float(left.shape[2])
    out = torch.empty(*left.shape[:2], right.shape[2], device=left.device)
    for one, other in ((left, right), (right, left)):
        one.fill_(_BETWEEN)
        other.fill_(1.0)
        if not bool((torch.bmm(left, right, out=out) == terms).all()):
            return False
    return True


def _products(shape: NetworkShape, rows: int, device: torch.device) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield what `forward` and `backward` multiply, sized and laid out in memory as there."""
    weights = Parameters(shape, device).weights
    hidden = Activations(shape, rows, device).hidden
    layers = [torch.empty(shape.robots, rows, shape.inputs, device=device), *hidden]
    delta = transposed(shape.robots, rows, shape.outputs, device)
    yield from zip(layers, weights[:-1], strict=False)
    yield weights[-1].mT, layers[-1].mT
    yield delta.mT, layers[-1]
    for layer in reversed(range(len(hidden))):
        yield delta, weights[layer + 1].mT
        delta = torch.empty_like(hidden[layer])
        yield layers[layer].mT, delta
