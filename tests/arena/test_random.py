from collections import deque
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.arena import Arena, Zone, load_arena, parse_arena
from robosim.arena.geometry import components
from robosim.arena.random import MOST_SEED, ROOM, random_arena
from robosim.control.evaluate import evaluate
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError

seeds = st.integers(0, MOST_SEED)


def steps_between(arena: Arena, robot_fits: np.ndarray) -> int | None:
    """Return the moves between cells from home to source, by plain search; None where there is no way."""
    steps = {(int(row), int(column)): 0 for row, column in np.argwhere(arena.zones == Zone.HOME)}
    queue = deque(steps)
    while queue:
        row, column = queue.popleft()
        if arena.zones[row, column] == Zone.SOURCE:
            return steps[row, column]
        for cell in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
            if robot_fits[cell] and cell not in steps:
                steps[cell] = steps[row, column] + 1
                queue.append(cell)
    return None


@given(seeds)
@settings(max_examples=8)
def test_every_arena_is_a_valid_file_in_which_home_and_source_are_joined(seed: int) -> None:
    text = random_arena(seed)
    arena = parse_arena(text, "drawn.toml")
    assert arena.name == f"random-{seed}"
    assert arena.capacity >= ROOM
    free = arena.zones != Zone.WALL
    # All free cells hang together: nothing was drawn beside the map.
    assert components(free).max() == 0
    # A cell is wider than a robot, so a way from cell to cell is one for a robot.
    assert arena.cell_size > arena.robot.width
    steps = steps_between(arena, free)
    assert steps is not None
    assert arena.tunnel_length >= 3
    # It leads through the tunnel, for without its cells there is no way.
    assert steps_between(arena, free & (arena.zones != Zone.TUNNEL)) is None


@given(seeds)
@settings(max_examples=3)
def test_equal_seeds_give_equal_files_and_others_give_others(seed: int) -> None:
    assert random_arena(seed) == random_arena(seed)
    assert random_arena(seed) != random_arena((seed + 1) % MOST_SEED)


def test_the_file_of_a_seed_does_not_change() -> None:
    # Runs name arenas by their seeds.
    lines = random_arena(3).split("\n")
    assert lines[:4] == [
        'name = "random-3"',
        'description = "Drawn at random: a tunnel 1 wide."',
        "cell_size = 0.15",
        'map = """',
    ]


def test_there_are_all_kinds_in_all_directions() -> None:
    arenas = [load_arena(random_arena(seed)) for seed in range(20)]
    words = " ".join(arena.description for arena in arenas)
    for kind in ("1 wide", "2 wide", "3 wide", "1 bend", "3 bends", "sidings", "an island", "second tunnel"):
        assert kind in words
    centres = [
        np.sign(np.argwhere(arena.zones == Zone.SOURCE).mean(axis=0).round() -
                np.argwhere(arena.zones == Zone.HOME).mean(axis=0).round())
        for arena in arenas
    ]  # fmt: skip
    assert {tuple(map(int, centre)) for centre in centres} >= {(1, 1), (1, -1), (-1, 1), (-1, -1)}


@pytest.mark.parametrize("seed", [11, 12])
def test_a_scripted_robot_delivers(seed: int, tmp_path: Path) -> None:
    (tmp_path / "drawn.toml").write_text(random_arena(seed))
    env = VectorEnv(tmp_path / "drawn.toml", robots=1, episode_steps=500)
    assert evaluate(LanesController(), env, 1).totals[0] >= 1


@pytest.mark.parametrize("seed", [-1, MOST_SEED + 1, True, 1.5])
def test_a_seed_is_a_whole_number(seed: object) -> None:
    with pytest.raises(InputError, match=r"^seed is .*, but must be a whole number from 0 to \d+\.$"):
        random_arena(seed)  # type: ignore[arg-type]
