"""Equality of what holds arrays."""

from __future__ import annotations

import dataclasses

import numpy as np


class EqualByValue:
    """Base of dataclasses that hold arrays, made with `eq=False`: equal are those whose fields all are.

    Arrays are equal that have the same kind, shape and numbers; not a number equals itself. The comparison
    that dataclasses come with asks whether an array is true, and raises.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        names = [field.name for field in dataclasses.fields(self)]  # type: ignore[arg-type]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]  # arrays can change


def _equal(one: object, other: object) -> bool:
    if not isinstance(one, np.ndarray) or not isinstance(other, np.ndarray):
        return bool(one == other)
    return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
