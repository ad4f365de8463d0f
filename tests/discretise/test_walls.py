"""Positions in walls are put to the border of the nearest free cell, and no others are touched."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import Zone, load_arena
from robosim.discretise.walls import Walls, nearest_free


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_free_cell_against_all_cells_looked_through(seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = rng.random((7, 11)) < 0.15
    free[rng.integers(7), rng.integers(11)] = True
    cells = np.argwhere(free)[:, ::-1]
    found = nearest_free(free)
    for row, column in np.ndindex(free.shape):
        distance = ((cells - (column, row)) ** 2).sum(axis=1)
        own = found[row, column]
        assert free[own[1], own[0]]
        assert ((own - (column, row)) ** 2).sum() == distance.min()


@given(x=st.floats(-1.0, 6.0), y=st.floats(-1.0, 3.0))
def test_a_position_in_a_wall_comes_to_the_border_of_a_free_cell_and_a_free_one_stays(x, y) -> None:
    arena = load_arena("paper")
    free = arena.zones != Zone.WALL
    size = arena.cell_size
    put = Walls(free, size).off(np.array([x, y]))
    column, row = (int(number) for number in np.floor(put / size))
    assert free[row, column]
    inside = 0.0 <= x < arena.size[0] and 0.0 <= y < arena.size[1]
    if inside and free[int(y / size), int(x / size)]:
        assert put.tolist() == [x, y]
    else:
        edge = np.abs(put / size - np.round(put / size)).min()
        assert edge < 1e-5
