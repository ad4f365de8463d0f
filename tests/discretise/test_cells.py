import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import load_arena, parse_arena
from robosim.arena.model import Zone
from robosim.discretise.cells import NEIGHBOURS, Grid
from tests.discretise.recorded import TINY

PAPER = load_arena("paper")


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_cells_and_what_is_free_around_them_are_those_of_loops(seed: int, margin: int) -> None:
    rng = np.random.default_rng(seed)
    envs, robots = 3, int(rng.integers(1, 9))
    rows, columns = np.nonzero(PAPER.zones != Zone.WALL)
    chosen = rng.integers(len(rows), size=(envs, robots))
    cell = np.stack([columns[chosen], rows[chosen]], axis=-1)
    places = (cell + rng.uniform(0.001, 0.999, (envs, robots, 2))) * PAPER.cell_size
    grid = Grid(PAPER, margin)
    coordinates = grid.cell_coordinates(places)
    flat = grid.flat_index(coordinates)
    free = grid.free_neighbours(flat)
    density = grid.tunnel_density(flat)
    for env in range(envs):
        here = [tuple(one) for one in cell[env].tolist()]
        inside = 0
        for robot, (column, row) in enumerate(here):
            x, y = places[env, robot]
            assert (math.floor(x / PAPER.cell_size), math.floor(y / PAPER.cell_size)) == (column, row)
            assert flat[env, robot] == (row + margin) * grid.shape[1] + column + margin
            assert grid.zones[flat[env, robot]] == PAPER.zones[row, column]
            inside += PAPER.zones[row, column] == Zone.TUNNEL
            for side, (dx, dy) in enumerate(NEIGHBOURS.tolist()):
                wall = PAPER.zones[row + dy, column + dx] == Zone.WALL
                taken = (column + dx, row + dy) in here
                assert free[env, robot, side] == (not wall and not taken)
        assert density[env] == pytest.approx(inside / 11, rel=1e-14)


def test_density_is_robots_over_length_and_may_exceed_one() -> None:
    grid = Grid(PAPER, 1)
    tunnel = np.flatnonzero(grid.zones == Zone.TUNNEL)
    assert len(tunnel) == 22
    assert grid.tunnel_density(tunnel[None, :])[0] == pytest.approx(2.0)
    outside = np.flatnonzero(grid.zones == Zone.HOME)
    cells = np.array([[tunnel[0], tunnel[1], outside[0]], [outside[0], outside[1], outside[2]]])
    assert grid.tunnel_density(cells).tolist() == [pytest.approx(2 / 11), 0.0]


def test_without_a_tunnel_density_is_zero() -> None:
    arena = parse_arena(TINY, "tiny.toml")
    assert arena.tunnel_length == 0
    grid = Grid(arena, 2)
    assert grid.tunnel_density(np.flatnonzero(grid.zones != Zone.WALL)[None, :]).tolist() == [0.0]
