"""Buffers of pymunk's batch interface, used again by one episode after another."""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymunk import batch


class Buffers(NamedTuple):
    """What a space is read and commanded through."""

    bodies: batch.Buffer
    arbiters: batch.Buffer
    commands: batch.Buffer
    """Its numbers lie in an array of numpy's, so it must not be filled by pymunk."""


_SPARE: list[Buffers] = []
"""Of episodes that are over. pymunk never frees what a buffer has grown to, so none may be thrown away."""


def borrow_buffers(user: object, commands: NDArray[np.float64]) -> Buffers:
    """Return empty buffers that are `user`'s as long as it lives; its `commands` are read from that array."""
    buffers = _SPARE.pop() if _SPARE else Buffers(batch.Buffer(), batch.Buffer(), batch.Buffer())
    weakref.finalize(user, _SPARE.append, buffers).atexit = False
    buffers.bodies.clear()
    buffers.arbiters.clear()
    buffers.commands.set_float_buf(commands)
    return buffers
