"""Every arena file either runs or is refused with a sentence; none stops the interpreter or gives a NaN."""

import importlib.util
import json
import os
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from robosim.arena.schema import PelletSection, RandomisationSection, RobotSection
from robosim.envs.vector import VectorEnv
from robosim.world.state import PelletStatus

_SPEC = importlib.util.spec_from_file_location(
    "arena_strategies", Path(__file__).parents[1] / "strategies" / "arenas.py"
)
assert _SPEC is not None
assert _SPEC.loader is not None
arenas = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(arenas)

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="an abort is only survived in a child")

STEPS = 50
RAN, REFUSED, FAILED = 0, 10, 11


def run(text: str, robots: int, kind: str) -> bool:
    """Run an arena with random actions, checking every decision; False where it is refused."""
    arena = arenas.arena_or_none(text)
    if arena is None:
        return False
    env = VectorEnv(arena, robots=min(robots, arena.capacity), seed=1, actions=kind)
    env.reset()
    rng = np.random.default_rng(0)
    state = env.world.state
    for _ in range(STEPS):
        transition = env.step(rng.integers(0, 5, (1, env.robots)))
        impulse = env.world.contacts.impulse
        for array in (
            state.pose, state.velocity, state.pellets, transition.observation, transition.reward, impulse
        ):  # fmt: skip
            assert np.isfinite(array).all()
        for place in (state.pose[..., :2], state.pellets):
            assert (place > 0.0).all(), place.min(axis=(0, 1))
            assert (place < arena.size).all(), place.max(axis=(0, 1))
        absent = (state.pellet_status == PelletStatus.ABSENT).sum()
        assert (state.delivered - state.refilled == absent).all()
    return True


def run_in_a_child(text: str, robots: int, kind: str) -> int:
    """Return how it went; an abort of the interpreter is a failure here and ends only the child."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        code = FAILED
        try:
            code = RAN if run(text, robots, kind) else REFUSED
        except BaseException:
            os.write(writer, traceback.format_exc()[-4000:].encode())
        os._exit(code)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        said = pipe.read()
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    assert code in {RAN, REFUSED}, f"ended with {code}\n{said}\n{text}"
    return code


def bounds(model: type[BaseModel]) -> dict[str, tuple[float, float]]:
    """Return the least and the greatest value that a table's numbers may have."""
    found: dict[str, tuple[float, float]] = {}
    for name, field in model.model_fields.items():
        limits = {
            key: getattr(part, key) for part in field.metadata for key in ("ge", "le") if hasattr(part, key)
        }
        if len(limits) == 2:
            found[name] = (limits["ge"], limits["le"])
    return found


@st.composite
def extreme_texts(draw: st.DrawFn) -> str:
    """The paper's map with masses, forces, frictions and factors at the ends of what is allowed."""
    tables: dict[str, dict[str, Any]] = {"robot": {}, "pellets": {}}
    for table, model in (("robot", RobotSection), ("pellets", PelletSection)):
        for key, ends in bounds(model).items():
            if key in {"length", "width", "wheel_radius", "max_wheel_speed", "radius", "count"}:
                continue
            value = draw(st.sampled_from([None, *ends]))
            if value is not None:
                tables[table][key] = value
    tables["robot"]["shape"] = draw(st.sampled_from(["circle", "capsule", "box"]))
    tables["pellets"] |= {
        "count": draw(st.sampled_from([1, 20])),
        "radius": draw(st.sampled_from([0.01, 0.02, 0.04])),
    }
    tables["timing"] = {"substeps": draw(st.sampled_from([6, 12, 60]))}
    factors = st.sampled_from([[1.0, 1.0], [0.1, 0.1], [10.0, 10.0], [0.1, 10.0]])
    tables["randomisation"] = {
        key: draw(factors) for key in RandomisationSection.model_fields if key != "wheel_speed"
    }
    drawing = arenas.SHIPPED["paper"].split('map = """')[1].split('"""')[0]
    lines = ['name = "extreme"', "cell_size = 0.15", f'map = """{drawing}"""']
    for table, values in tables.items():
        lines += [f"[{table}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    return "\n".join(lines)


KINDS = st.sampled_from(["cardinal", "wheels"])


@pytest.mark.parametrize("examples", [25, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("strategy", ["drawn", "damaged", "extreme"])
def test_every_arena_file_runs_or_is_refused(strategy, examples) -> None:
    texts = {"drawn": arenas.arena_texts(), "damaged": arenas.damaged_texts(), "extreme": extreme_texts()}
    seen = {RAN: 0, REFUSED: 0}

    @settings(max_examples=examples)
    @given(texts[strategy], st.integers(1, 3), KINDS)
    def check(text: str, robots: int, kind: str) -> None:
        seen[run_in_a_child(text, robots, kind)] += 1

    check()
    print(f"{strategy} arenas: {seen[RAN]} ran {STEPS} decisions, {seen[REFUSED]} were refused")
    assert seen[RAN] >= examples // 12


def test_a_child_that_aborts_is_noticed() -> None:
    """The check itself: pymunk aborts the interpreter for a mass of NaN."""
    child = os.fork()
    if child == 0:
        import faulthandler

        import pymunk

        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        pymunk.Body(float("nan"), 1.0)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) < 0
