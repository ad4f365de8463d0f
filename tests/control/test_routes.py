"""Routes: every direction keeps right; one-robot-wide tunnels have gates; a turned map has turned routes."""

import numpy as np
import pytest

from robosim.arena import Arena, Zone, arena_names, load_arena, parse_arena
from robosim.arena.model import GOALS
from robosim.control.routes import INBOUND, OUTBOUND, plan_routes
from robosim.robot.drivers import CARDINAL_STEPS
from robosim.robot.team import ROLES

NORTH, SOUTH, WEST, EAST = range(4)


def arena_of(drawing: str, robot: str = "") -> Arena:
    text = f'name = "drawn"\ncell_size = 0.15\nmap = """\n{drawing}\n"""\n[pellets]\ncount = 5\n{robot}'
    return parse_arena(text, "drawn")


def route(arena: Arena, row: int, column: int, direction: int) -> list[tuple[int, int]]:
    """Return the cells (row, column, of the arena) from one to the goal, each step downhill."""
    cost = plan_routes(arena).cost[direction]
    cells = [(row, column)]
    while cost[row + 1, column + 1] > 0.0:
        around = [cost[row + 1 + y, column + 1 + x] for x, y in CARDINAL_STEPS[:4]]
        x, y = CARDINAL_STEPS[int(np.argmin(around))]
        row, column = row + int(y), column + int(x)
        cells.append((row, column))
        assert len(cells) < 500
    return cells


def in_tunnel(arena: Arena, cells: list[tuple[int, int]]) -> list[tuple[int, int]]:
    return [cell for cell in cells if arena.zones[cell] == Zone.TUNNEL]


def ends(arena: Arena) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return a cell of the home and one of the source."""
    home = np.argwhere(arena.zones == Zone.HOME)
    source = np.argwhere(arena.zones == Zone.SOURCE)
    return tuple(home[len(home) // 2]), tuple(source[len(source) // 2])


def test_costs_are_those_of_the_shortest_routes_by_a_slow_reference() -> None:
    """Bellman-Ford over the same map: without lanes every cell costs one."""
    arena = arena_of("##########\n#HH....SS#\n#HH.##.SS#\n#HH....SS#\n##########")
    routes = plan_routes(arena)
    free = routes.zones != Zone.WALL
    for direction, zone in ((INBOUND, Zone.SOURCE), (OUTBOUND, Zone.HOME)):
        cost = np.where(routes.zones == zone, 0.0, np.inf)
        for _ in range(free.size):
            for x, y in CARDINAL_STEPS[:4]:
                beyond = np.roll(cost, (y, x), axis=(0, 1)) + 1.0
                cost = np.where(free, np.minimum(cost, beyond), np.inf)
        assert np.array_equal(routes.cost[direction], cost)


@pytest.mark.parametrize("name", arena_names())
def test_every_free_cell_leads_to_both_goals(name) -> None:
    arena = load_arena(name)
    routes = plan_routes(arena)
    free = np.pad(arena.zones, 1, constant_values=Zone.WALL) != Zone.WALL
    assert np.isfinite(routes.cost[:, free]).all()
    assert np.isinf(routes.cost[:, ~free]).all()
    home, source = ends(arena)
    for number, group in enumerate(arena.team(1).groups):
        brings, takes = GOALS[ROLES[group.role]]
        assert arena.zones[route(arena, *home, 2 * number + INBOUND)[-1]] == takes
        assert arena.zones[route(arena, *source, 2 * number + OUTBOUND)[-1]] == brings


@pytest.mark.parametrize("name", ["paper", "long", "robotarium", "s-bend", "three-wide"])
def test_both_directions_keep_right_and_never_share_a_lane(name) -> None:
    arena = load_arena(name)
    home, source = ends(arena)
    inbound = route(arena, *home, INBOUND)
    outbound = route(arena, *source, OUTBOUND)
    lanes = [set(in_tunnel(arena, cells)) for cells in (inbound, outbound)]
    assert lanes[0]
    assert lanes[1]
    assert not lanes[0] & lanes[1]
    assert plan_routes(arena).gates == 0


@pytest.mark.parametrize("name", ["paper", "long", "robotarium"])
def test_the_straight_tunnel_east_is_driven_in_the_south_lane_and_west_in_the_north(name) -> None:
    arena = load_arena(name)
    home, source = ends(arena)
    rows = np.unique(np.argwhere(arena.zones == Zone.TUNNEL)[:, 0])
    assert {row for row, _ in in_tunnel(arena, route(arena, *home, INBOUND))} == {rows.min()}
    assert {row for row, _ in in_tunnel(arena, route(arena, *source, OUTBOUND))} == {rows.max()}


def test_a_tunnel_one_robot_wide_has_a_gate_and_a_mouth_to_keep_clear() -> None:
    arena = load_arena("single-lane")
    routes = plan_routes(arena)
    assert routes.gates == 1
    tunnel = routes.zones == Zone.TUNNEL
    assert (routes.gate[tunnel] == 0).all()
    assert (routes.gate[~tunnel] == -1).all()
    mouth = routes.mouth >= 0
    assert mouth.any()
    assert not (mouth & tunnel).any()
    assert not (mouth & (routes.zones == Zone.WALL)).any()
    # Out of the mouth there is always a route, and nowhere else is one needed.
    free = routes.zones != Zone.WALL
    assert np.isfinite(routes.aside[free]).all()
    assert (routes.aside[mouth] > 0.0).all()
    assert (routes.aside[free & ~mouth & ~tunnel] == 0.0).all()


def test_of_two_narrow_tunnels_each_has_one_direction_and_none_a_gate() -> None:
    arena = load_arena("two-tunnels")
    home, source = ends(arena)
    used = [
        {row for row, _ in in_tunnel(arena, cells)}
        for cells in (route(arena, *home, INBOUND), route(arena, *source, OUTBOUND))
    ]
    assert [len(rows) for rows in used] == [1, 1]
    assert used[0] != used[1]
    assert plan_routes(arena).gates == 0


@pytest.mark.parametrize("name", ["paper", "single-lane", "s-bend", "robotarium", "long"])
def test_routes_of_a_half_turned_map_are_the_half_turned_routes(name) -> None:
    """Turned by 180 degrees right stays right; home and source stay what they are."""
    arena = load_arena(name)
    lines = arena.text.split('map = """\n')[1].split('\n"""')[0].split("\n")
    turned = parse_arena(
        arena.text.replace("\n".join(lines), "\n".join(line[::-1] for line in reversed(lines))), "turned"
    )
    plain, other = plan_routes(arena), plan_routes(turned)
    assert np.array_equal(other.cost, plain.cost[:, ::-1, ::-1])
    assert np.array_equal(other.gate, plain.gate[::-1, ::-1])
    assert np.array_equal(other.mouth, plain.mouth[::-1, ::-1])
    assert np.array_equal(other.aside, plain.aside[::-1, ::-1])


@pytest.mark.parametrize("name", ["paper", "robotarium", "long"])
def test_in_a_mirror_the_directions_change_lanes(name) -> None:
    """Left and right exchanged, what was the lane in is the lane out."""
    arena = load_arena(name)
    lines = arena.text.split('map = """\n')[1].split('\n"""')[0].split("\n")
    flipped = parse_arena(arena.text.replace("\n".join(lines), "\n".join(reversed(lines))), "flipped")
    home, source = ends(arena)
    assert {row for row, _ in in_tunnel(arena, route(arena, *home, INBOUND))} == {
        row for row, _ in in_tunnel(flipped, route(flipped, *ends(flipped)[0], INBOUND))
    }
    assert {row for row, _ in in_tunnel(arena, route(arena, *source, OUTBOUND))} == {
        row for row, _ in in_tunnel(flipped, route(flipped, *ends(flipped)[1], OUTBOUND))
    }


def test_long_robots_follow_a_tunnel_along_its_axis_and_round_ones_need_not() -> None:
    drawing = "##########\n#HH.TT.SS#\n#HH.TT.SS#\n##########"
    capsule = '[robot]\nshape = "capsule"\nlength = 0.2\nwidth = 0.1\n'
    round_robot, long_robot = plan_routes(arena_of(drawing)), plan_routes(arena_of(drawing, capsule))
    tunnel = long_robot.zones == Zone.TUNNEL
    assert (round_robot.axis == -1).all()
    assert (long_robot.axis[INBOUND][tunnel] == EAST).all()
    assert (long_robot.axis[OUTBOUND][tunnel] == WEST).all()
    assert (long_robot.axis[:, ~tunnel] == -1).all()
