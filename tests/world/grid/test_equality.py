"""The batched grid does in every decision what the slow plain one does."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from robosim.arena import Arena, load_arena, parse_arena
from robosim.errors import InputError
from robosim.world.grid import GridWorld
from robosim.world.state import PelletStatus
from tests.strategies.arenas import OF_EQUALS
from tests.world.grid.plain import PlainGrid

_SPEC = importlib.util.spec_from_file_location(
    "arena_strategies", Path(__file__).parents[2] / "strategies" / "arenas.py"
)
assert _SPEC is not None
assert _SPEC.loader is not None
arenas = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(arenas)

MEASURES = ("pose", "velocity", "pellets")


def compare(world: GridWorld, plains: list[PlainGrid]) -> None:
    for env, plain in enumerate(plains):
        for name, expected in plain.state().items():
            found = getattr(world.state, name)
            found = found[:, env] if name == "touched" else found[env]
            if name == "velocity":
                # Half a turn may be counted with either sign.
                half = np.abs(np.abs(found[:, 2]) * plain.arena.timing.decision_period - np.pi) < 1e-9
                expected = np.where(half[:, None] & (np.arange(3) == 2), found, expected)
            if name in MEASURES:
                assert_allclose(found, np.array(expected).reshape(found.shape), atol=1e-9, err_msg=name)
            else:
                assert_array_equal(found, expected, err_msg=f"{name} in decision {plain.decisions}")
        contacts = world.contacts.of_env(env)
        assert [tuple(row) for row in zip(contacts.kind.tolist(), contacts.a.tolist(), contacts.b.tolist(),
                strict=True)] == [row[:3] for row in plain.contacts]  # fmt: skip
        places = np.array([row[3:] for row in plain.contacts]).reshape(-1, 2)
        assert_allclose(contacts.position, places, atol=1e-9)
        assert_allclose(contacts.time, plain.decisions * plain.arena.timing.decision_period)


def conserved(world: GridWorld) -> None:
    """No pellet is lost or made, and every robot stands alone in the middle of a free cell."""
    state, arena = world.state, world.arena
    loose, held, absent = ((state.pellet_status == status).sum(axis=1) for status in PelletStatus)
    assert (loose + held + absent == arena.pellets.count).all()
    assert (state.delivered == state.refilled + absent).all()
    assert (held == (state.held >= 0).sum(axis=1)).all()
    cells = state.pose[..., :2] / arena.cell_size
    assert_allclose(cells % 1.0, 0.5, atol=1e-6)
    column, row = cells.astype(int)[..., 0], cells.astype(int)[..., 1]
    assert (arena.zones[row, column] != 0).all()
    for env in range(world.num_envs):
        assert len(set(zip(row[env].tolist(), column[env].tolist(), strict=True))) == world.robots


def run_beside(
    arena: Arena, robots: int, envs: int, actions: str, decisions: int, seed: int = 0
) -> GridWorld:
    """Run both worlds with random actions and grippers, and compare them after every decision."""
    world = GridWorld(arena, robots, envs, actions)
    seeds = [np.random.SeedSequence((seed, env)) for env in range(envs)]
    world.reset(seeds)
    plains = [PlainGrid(arena, robots, one, actions) for one in seeds]
    compare(world, plains)
    rng = np.random.default_rng(seed)
    for _ in range(decisions):
        chosen = rng.integers(0, 5, (envs, robots))
        # Mostly take and keep, and let go at times.
        gripper = rng.choice(np.array([-1, 0, 1, 1], dtype=np.int8), (envs, robots))
        world.step(chosen, gripper)
        for env, plain in enumerate(plains):
            plain.step(chosen[env].tolist(), gripper[env].tolist())
        compare(world, plains)
        conserved(world)
    return world


@pytest.mark.parametrize("actions", ["cardinal", "wheels"])
@pytest.mark.parametrize("name", OF_EQUALS)
def test_on_every_arena_that_ships(name: str, actions: str) -> None:
    run_beside(load_arena(name), 8, 2, actions, 40)


def test_where_pellets_are_delivered_and_come_back() -> None:
    """Home and source side by side, so that chance alone delivers."""
    drawing = "\n" + "#" * 9 + "\n" + "#HHSSTHH#\n" * 3 + "#" * 9 + "\n"
    text = f'name = "near"\ncell_size = 0.15\nmap = """{drawing}"""\n[pellets]\ncount = 9\n'
    arena = parse_arena(text, "near.toml")
    world = run_beside(arena, 9, 3, "cardinal", 400)
    print("delivered:", world.state.delivered, "refilled:", world.state.refilled)
    assert (world.state.delivered > 20).all()


def test_on_arenas_that_are_drawn() -> None:
    seen = {"ran": 0, "refused": 0}

    @settings(max_examples=60)
    @given(arenas.arena_texts(), st.integers(1, 6), st.sampled_from(["cardinal", "wheels"]))
    def check(text: str, robots: int, actions: str) -> None:
        arena = arenas.arena_or_none(text)
        if arena is None:
            seen["refused"] += 1
            return
        try:
            capacity = GridWorld(arena, 1, 1, actions).arena.capacity
        except InputError:
            seen["refused"] += 1
            return
        run_beside(arena, min(robots, capacity), 1, actions, 15)
        seen["ran"] += 1

    check()
    print(seen)
    assert seen["ran"] >= 5
