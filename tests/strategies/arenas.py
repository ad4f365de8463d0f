"""Arena files for property tests: drawn from scratch, and shipped ones with damage."""

from __future__ import annotations

import json
from typing import Any

from hypothesis import strategies as st

from robosim.arena import Arena, arena_names, load_arena, parse_arena
from robosim.errors import InputError

ODD_NUMBERS = [
    "-1", "0", "-0.0", "1e-300", "1e300", "1e999", "nan", "-inf", "9" * 40, "9" * 5000, "0x7f", "3", "0.02",
    "true", '"0.1"', "[]", "[1, 2]", "{}", "1979-05-27", "2.5e-3", "200", "12.5",
]  # fmt: skip

SHIPPED = {name: load_arena(name).text for name in arena_names()}
OF_EQUALS = [name for name in arena_names() if not load_arena(name).groups]
"""Shipped arenas that ask for no mixed team."""


def arena_or_none(text: str) -> Arena | None:
    """Load a text; None when it is refused with at least one sentence, as wrong input should be."""
    try:
        return parse_arena(text, "drawn.toml")
    except InputError as refusal:
        for sentence in str(refusal).split("\n"):
            assert sentence.startswith("drawn.toml: "), sentence
            assert sentence[-1] in ".?", sentence
        return None


@st.composite
def maps(draw: st.DrawFn) -> str:
    """A closed map with a home room and a source room; most have a path between them."""
    columns, rows = draw(st.integers(6, 14)), draw(st.integers(3, 8))
    grid = [[draw(st.sampled_from("..T#")) for _ in range(columns)] for _ in range(rows)]
    width, height = draw(st.integers(1, 3)), draw(st.integers(1, rows))
    for row in range(height):
        for column in range(width):
            grid[row][column] = "H"
            grid[rows - 1 - row][columns - 1 - column] = "S"
    lane = draw(st.integers(0, rows - 1))
    for column in range(width, columns - width):
        grid[lane][column] = "T"
    if draw(st.booleans()):
        for row in range(rows):
            for column in (width, columns - width - 1):
                grid[row][column] = "."
    edge = "#" * (columns + 2)
    return "\n".join([edge, *("#" + "".join(line) + "#" for line in grid), edge])


def _one_of_often(likely: Any, others: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.one_of(st.just(likely), st.just(likely), others)


@st.composite
def arena_texts(draw: st.DrawFn) -> str:
    """An arena file in which every value may lie anywhere near its allowed range; many are valid."""
    length = draw(st.floats(0.05, 0.3))
    shape = draw(st.sampled_from(["circle", "capsule", "box"]))
    width = length if shape == "circle" else length * draw(st.floats(0.3, 1.05))
    radius = draw(st.floats(0.004, 0.05))
    control = draw(st.sampled_from([0.02, 0.05, 0.1]))
    low = draw(st.floats(0.05, 1.2))
    tables: dict[str, dict[str, Any]] = {
        "robot": {
            "shape": shape,
            "length": length,
            "width": width,
            "mass": draw(_one_of_often(0.4, st.floats(0.005, 120.0))),
            "wheel_base": draw(_one_of_often(0.1, st.floats(0.004, 2.1))),
            "traction": draw(st.floats(0.01, 5.0)),
            "friction": draw(st.floats(0.0, 5.0)),
            "grip_force": draw(st.floats(0.001, 1000.0)),
            "max_wheel_acceleration": draw(_one_of_often(125.0, st.floats(0.05, 200_000.0))),
        },
        "pellets": {
            "count": draw(st.integers(1, 40)),
            "radius": radius,
            "mass": draw(st.floats(0.0001, 10.0)),
            "friction": draw(st.floats(0.0, 5.0)),
            "cohesion": draw(_one_of_often(0.0, st.floats(0.0, 120.0))),
        },
        "timing": {
            "control_period": control,
            "decision_period": control * draw(_one_of_often(3, st.integers(1, 5) | st.floats(0.5, 5.0))),
            "substeps": draw(_one_of_often(20, st.integers(1, 210))),
        },
        "randomisation": {"robot_mass": [low, low + draw(st.floats(-0.1, 3.0))]},
    }
    if draw(st.booleans()):
        del tables["randomisation"]
    if draw(st.integers(0, 3)) == 0:
        place = st.floats(0.0, 2.5)
        poses = draw(st.lists(st.tuples(place, place, st.floats(-7.0, 7.0)), max_size=3))
        tables["start"] = {"poses": [list(pose) for pose in poses]}
    cell_size = draw(st.floats(1.05, 2.5)) * length
    lines = ['name = "drawn"', f"cell_size = {cell_size}", f'map = """\n{draw(maps())}\n"""']
    for table, values in tables.items():
        lines += [f"[{table}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    return "\n".join(lines)


@st.composite
def damaged_texts(draw: st.DrawFn) -> str:
    """A shipped arena's file with one to three pieces of damage."""
    text = SHIPPED[draw(st.sampled_from(sorted(SHIPPED)))]
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["cells", "number", "cut", "insert", "swap", "key"]))
        if kind == "cells":
            at = draw(st.integers(0, len(text) - 1))
            text = text[:at] + draw(st.text("#.HST x\n", max_size=4)) + text[at + draw(st.integers(0, 4)) :]
        elif kind == "number":
            lines = text.split("\n")
            numbered = [index for index, line in enumerate(lines) if "= " in line and '"' not in line] or [0]
            index = draw(st.sampled_from(numbered))
            lines[index] = lines[index].split("=")[0] + "= " + draw(st.sampled_from(ODD_NUMBERS))
            text = "\n".join(lines)
        elif kind == "cut":
            begin = draw(st.integers(0, len(text)))
            text = text[:begin] + text[begin + draw(st.integers(0, 40)) :]
        elif kind == "insert":
            at = draw(st.integers(0, len(text)))
            text = text[:at] + draw(st.text(max_size=3)) + text[at:]
        elif kind == "swap":
            lines = text.split("\n")
            first, second = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
            lines[first], lines[second] = lines[second], lines[first]
            text = "\n".join(lines)
        else:
            key = draw(
                st.sampled_from(
                    ["mass", "wheel_speed", "zone", "poses", "substeps", "count", "shape", "role"]
                )
            )
            tables = ["robot", "pellets", "timing", "start", "randomisation", "[groups]", "groups.robot"]
            table = draw(st.sampled_from(tables))
            text += f"\n[{table}]\n{key} = {draw(st.sampled_from(ODD_NUMBERS))}\n"
        text = text or "#"
    return text
