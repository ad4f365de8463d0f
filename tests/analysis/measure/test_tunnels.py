"""Where tunnels are, how long, and what belongs to them."""

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_array_equal

from robosim.analysis.measure.tunnels import find_tunnels
from robosim.arena import arena_names, load_arena, parse_arena
from robosim.arena.model import Zone
from tests.analysis.handmade import Run, middle, small, without_tunnel
from tests.analysis.plain import PlainRun
from tests.strategies.arenas import arena_or_none, arena_texts


def test_a_straight_tunnel_is_as_long_as_its_cells():
    """Eleven cells of 0.15 m begin three cells from the home; 0.2 m/s takes 8.25 s."""
    tunnels = find_tunnels(load_arena("paper"))
    assert tunnels.count == 1
    assert tunnels.home_end == pytest.approx([0.45])
    assert tunnels.length == pytest.approx([1.65])
    assert tunnels.transit_time == pytest.approx([8.25])
    assert (tunnels.inside == 0).sum() == 22


def test_tunnels_are_kept_apart():
    tunnels = find_tunnels(load_arena("two-tunnels"))
    assert tunnels.count == 2
    assert tunnels.length == pytest.approx([1.65, 1.65])
    rows, columns = tunnels.cells(np.array([middle(12, 2), middle(12, 6), middle(2, 2)]))
    assert tunnels.inside[rows, columns].tolist() == [0, 1, -1]


def test_a_bend_is_measured_along_the_shortest_path():
    """Shorter than its 22 cells, since the path cuts corners; longer than straight from end to end."""
    length = find_tunnels(load_arena("s-bend")).length[0]
    assert np.hypot(18, 9) * 0.15 - 0.3 < length < 22 * 0.15


def test_the_mouth_reaches_a_robots_length_into_the_floor():
    """One cell of 0.15 m holds a robot of 0.11 m; two of 0.08 m are wanted for one of 0.15 m."""
    paper, three = find_tunnels(load_arena("paper")), find_tunnels(load_arena("three-wide"))
    assert [int(column) for column in np.flatnonzero(paper.near[3] == 0)[[0, -1]]] == [7, 19]
    assert [int(column) for column in np.flatnonzero(three.near[6] == 0)[[0, -1]]] == [11, 35]
    for tunnels, name in ((paper, "paper"), (three, "three-wide")):
        assert (load_arena(name).zones[tunnels.near >= 0] != Zone.WALL).all()


def test_no_tunnel_is_no_trouble():
    tunnels = find_tunnels(without_tunnel())
    assert tunnels.count == 0
    assert (tunnels.inside == -1).all()
    assert (tunnels.near == -1).all()
    assert len(tunnels.length) == len(tunnels.transit_time) == 0


def test_places_beyond_the_map_fall_to_its_edge():
    tunnels = find_tunnels(small())
    rows, columns = tunnels.cells(np.array([[-1.0, -1.0], [9.0, 9.0]]))
    assert rows.tolist() == [0, small().rows - 1]
    assert columns.tolist() == [0, small().columns - 1]


def _same_as_plain(arena):
    tunnels, plain = find_tunnels(arena), PlainRun(Run(arena, 0, []))
    numbers = np.full(arena.zones.shape, -1)
    for cell, tunnel in plain.tunnel_of.items():
        numbers[cell] = tunnel
    near = np.full(arena.zones.shape, False)
    for cell in plain.near_of:
        near[cell] = True
    assert_array_equal(tunnels.inside, numbers)
    assert_array_equal(tunnels.near >= 0, near)
    assert tunnels.home_end == pytest.approx(plain.home_end)
    assert tunnels.length == pytest.approx(plain.length)


@pytest.mark.parametrize("name", arena_names())
def test_shipped_arenas_are_read_as_the_plain_reading_does(name):
    _same_as_plain(load_arena(name))


@given(arena_texts())
def test_in_any_arena_every_tunnel_has_a_length(text):
    arena = arena_or_none(text)
    if arena is None:
        return
    _same_as_plain(arena)
    tunnels = find_tunnels(arena)
    assert np.isfinite(tunnels.home_end).all()
    assert (tunnels.length >= arena.cell_size * (1 - 1e-9)).all()
    assert ((tunnels.inside >= 0) == (arena.zones == Zone.TUNNEL)).all()


def test_a_tunnel_that_nobody_can_reach_is_still_finite():
    text = (
        small()
        .text.replace("#H.##.SS#", "#H.....S#")
        .replace("#H.TTT..#\n", "#H.TTT..#\n#########\n#TTT#####\n")
    )
    tunnels = find_tunnels(parse_arena(text, "walled.toml"))
    assert tunnels.count == 3
    assert np.isfinite(tunnels.length).all()
