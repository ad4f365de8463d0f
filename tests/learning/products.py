"""Products as processors make them: this one's own, and those of others, put in the place of torch's."""

import pytest
import torch

from robosim.learning.precision import products_in, rounds_to_bfloat16

_bmm = torch.bmm


def this_one(monkeypatch):
    """Return None: what this processor does is found out."""
    rounds_to_bfloat16.cache_clear()


def one_that_rounds(monkeypatch):
    """Products as with AMX: operands are rounded to bfloat16 where that is allowed."""
    _install(monkeypatch, lambda operand: operand.bfloat16().float())
    return True


def one_that_adds_in_another_order(monkeypatch):
    """Products as with AVX-512 BF16 alone: other bits where rounding is allowed, but none of it."""
    _install(monkeypatch, lambda operand: operand, order=-1)
    return False


def one_with_tf32(monkeypatch):
    """Products as on a GPU: rounded where that is allowed, but to ten bits after the first."""
    _install(monkeypatch, lambda operand: (operand.view(torch.int32) + 0x1000 & ~0x1FFF).view(torch.float32))
    return False


PROCESSORS = [
    pytest.param(processor, id=processor.__name__)
    for processor in (this_one, one_that_rounds, one_that_adds_in_another_order, one_with_tf32)
]


def _install(monkeypatch, rounded, order=1):
    def bmm(left, right, out):
        if torch.get_float32_matmul_precision() == "highest":
            return _bmm(left, right, out=out)
        if order < 0:
            left, right = left.flip(2), right.flip(1)
        # This processor may round besides, where that is allowed.
        with products_in("float32"):
            return _bmm(rounded(left), rounded(right), out=out)

    rounds_to_bfloat16.cache_clear()
    monkeypatch.setattr(torch, "bmm", bmm)
