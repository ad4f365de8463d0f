"""Dataclasses that hold arrays: equal by value, not by a comparison that asks an array for its truth."""

from __future__ import annotations

import ast
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import robosim
from robosim.equality import EqualByValue

ARRAYS = {"NDArray", "Floats", "Integers", "Places", "Zones", "Tensor"}


@dataclass(frozen=True, slots=True, eq=False)
class Inner(EqualByValue):
    numbers: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Outer(EqualByValue):
    name: str
    inner: Inner
    numbers: NDArray[np.generic]


def outer() -> Outer:
    return Outer("a", Inner(np.array([1.0, np.nan])), np.arange(3))


def test_equal_are_those_whose_fields_all_are() -> None:
    one = outer()
    assert one == outer()
    assert one == one
    assert one != replace(one, name="b")
    assert one != replace(one, inner=Inner(np.array([1.0, 2.0])))
    assert one != replace(one, numbers=np.arange(4))
    assert one != replace(one, numbers=np.arange(3.0))
    assert one != replace(one, numbers=np.arange(3)[:, None])
    assert one != one.inner
    assert one != "a"


def test_they_are_no_keys_for_arrays_can_change() -> None:
    with pytest.raises(TypeError, match="unhashable"):
        hash(outer())


def holders(tree: ast.Module) -> list[ast.ClassDef]:
    """Dataclasses with a field whose type names an array."""
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        and any("dataclass" in ast.unparse(mark) for mark in node.decorator_list)
        and any(
            isinstance(name, ast.Name) and name.id in ARRAYS
            for field in node.body
            if isinstance(field, ast.AnnAssign)
            for name in ast.walk(field.annotation)
        )
    ]


def test_no_dataclass_that_holds_arrays_keeps_the_comparison_it_would_come_with() -> None:
    found = {
        (path.name, holder.name): "eq=False" in "".join(ast.unparse(mark) for mark in holder.decorator_list)
        for path in Path(robosim.__file__).parent.rglob("*.py")
        if "@dataclass" in (text := path.read_text(encoding="utf-8"))
        for holder in holders(ast.parse(text))
    }
    assert len(found) > 20
    assert [name for name, own in found.items() if not own] == []
