"""Routes for controllers with full knowledge of the map: lanes in tunnels, and the route along them.

The search for shortest routes (Dijkstra) is written out: on the arenas that ship it takes milliseconds, where
importing scipy's takes a third of a second.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.arena.geometry import components
from robosim.arena.model import GOALS, Arena, Zone
from robosim.equality import EqualByValue
from robosim.robot.drivers import CARDINAL_STEPS
from robosim.robot.sheet import RobotSheet
from robosim.robot.team import ROLES, Group

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

WRONG_LANE_COST = 12.0
"""What a cell of the oncoming lane costs, in cells: taken only where there is no other route."""
MIDDLE_LANE_COST = 3.0
"""What a cell between the two lanes of a wide tunnel costs, in cells."""
NEAR_WALL_COST = 10.0
"""What a cell costs, in cells, where the robot has no room to turn."""
MOUTH_REACH = 3.0
"""How far around the mouth of a one-robot-wide tunnel nobody waits, in cells."""
INBOUND, OUTBOUND = 0, 1


@dataclass(frozen=True, slots=True, eq=False)
class Routes(EqualByValue):
    """Where to go from every cell, on a grid padded by one wall on each side."""

    cost: Floats
    """[2 * groups, rows + 2, columns + 2] for each group, cost to where it takes pellets, the source for most
    (inbound), and to where it brings them, the home (outbound); inf in walls."""
    axis: Integers
    """[2 * groups, rows + 2, columns + 2] the action that follows a tunnel inbound and outbound; -1 outside
    tunnels, and everywhere for robots that can turn on the spot in a tunnel."""
    zones: NDArray[np.uint8]
    """[rows + 2, columns + 2]."""
    gate: Integers
    """[rows + 2, columns + 2] number of the one-robot-wide tunnel that a cell belongs to, or -1."""
    mouth: Integers
    """[rows + 2, columns + 2] number of the one-robot-wide tunnel in whose mouth the cell lies, or -1."""
    aside: Floats
    """[rows + 2, columns + 2] cells to the end of what must be kept clear; 0 outside it, inf in walls."""
    gates: int
    """How many one-robot-wide tunnels carry traffic in both directions."""


def plan_routes(arena: Arena) -> Routes:
    """Work out lanes: to the right in a wide tunnel; one direction for each of several where that helps."""
    zones = np.pad(arena.zones, 1, constant_values=int(Zone.WALL))
    free = zones != Zone.WALL
    team = arena.team(1)
    tunnels = components(zones == Zone.TUNNEL)
    count = int(tunnels.max()) + 1
    narrow = [_is_narrow(tunnels == tunnel, free) for tunnel in range(count)]
    # One tunnel in, the others out: nobody meets anybody. Where each role has its own way, tunnels may lie
    # one behind the other.
    one_way = count > 1 and any(narrow) and all(group.role == "all-round" for group in team.groups)
    shared = [] if one_way else list(range(count))
    ways = [_ways(arena, group, zones, tunnels, narrow, one_way) for group in team.groups]
    gate = np.full(zones.shape, -1)
    gates = 0
    for tunnel in shared:
        if narrow[tunnel]:
            gate[tunnels == tunnel] = gates
            gates += 1
    mouth = _mouths(gate, free, costs_to(free, gate >= 0, _straight_ahead_is_near(gate, free)))
    aside = costs_to(free, free & (gate < 0) & (mouth < 0), np.ones(zones.shape))
    cost, axis = (np.concatenate(parts) for parts in zip(*ways, strict=True))
    return Routes(cost, axis, zones, gate, mouth, aside, gates)


def _ways(
    arena: Arena,
    group: Group,
    zones: NDArray[np.uint8],
    tunnels: Integers,
    narrow: list[bool],
    one_way: bool,
) -> tuple[Floats, Integers]:
    """Return cost and axis of a group, [2, rows + 2, columns + 2] each, as `Routes` holds them."""
    free = zones != Zone.WALL
    brings, takes = (zones == goal for goal in GOALS[ROLES[group.role]])
    to_source = costs_to(free, takes, np.ones(zones.shape))
    to_home = costs_to(free, brings, np.ones(zones.shape))
    fee = np.ones((2, *zones.shape))
    fee[:, cramped_cells(group.sheet, arena.cell_size, free) & (zones != Zone.TUNNEL)] = NEAR_WALL_COST
    if one_way:
        first = min(range(len(narrow)), key=lambda tunnel: float(to_source[tunnels == tunnel].min()))
        for tunnel in range(len(narrow)):
            fee[OUTBOUND if tunnel == first else INBOUND][tunnels == tunnel] = WRONG_LANE_COST
    else:
        for tunnel in range(len(narrow)):
            if not narrow[tunnel]:
                _mark_lanes(fee, tunnels == tunnel, free, to_source, to_home)
    cost = np.stack([costs_to(free, takes, fee[INBOUND]), costs_to(free, brings, fee[OUTBOUND])])
    axis = np.full((2, *zones.shape), -1)
    if group.sheet.shape != "circle":
        for direction, plain in ((INBOUND, to_source), (OUTBOUND, to_home)):
            for row, column in np.argwhere(zones == Zone.TUNNEL).tolist():
                axis[direction, row, column] = _downhill(plain, row, column)
    return cost, axis


def cramped_cells(sheet: RobotSheet, cell_size: float, free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells at whose centre a robot is too near to a wall to turn on the spot."""
    if sheet.outer_radius <= 0.5 * cell_size:
        return np.zeros_like(free)
    cramped = np.zeros_like(free)
    for step_x, step_y in CARDINAL_STEPS[:4].tolist():
        cramped |= ~np.roll(free, (step_y, step_x), axis=(0, 1))
    return cramped & free


def costs_to(free: NDArray[np.bool_], goal: NDArray[np.bool_], fee: Floats) -> Floats:
    """Return the least cost from every cell to the goal, over the four neighbours (Dijkstra)."""
    cost = np.full(free.shape, np.inf)
    cost[goal] = 0.0
    queue = [(0.0, int(row), int(column)) for row, column in np.argwhere(goal)]
    heapq.heapify(queue)
    while queue:
        here, row, column = heapq.heappop(queue)
        if here > cost[row, column]:
            continue
        for step_x, step_y in CARDINAL_STEPS[:4].tolist():
            neighbour = (row - step_y, column - step_x)
            there = here + float(fee[neighbour])
            if free[neighbour] and there < cost[neighbour]:
                cost[neighbour] = there
                heapq.heappush(queue, (there, *neighbour))
    return cost


def _is_narrow(tunnel: NDArray[np.bool_], free: NDArray[np.bool_]) -> bool:
    """Return whether somewhere in the tunnel a cell has walls on two opposite sides."""
    cells = np.argwhere(tunnel)
    rows, columns = cells[:, 0], cells[:, 1]
    shut_y = ~free[rows + 1, columns] & ~free[rows - 1, columns]
    shut_x = ~free[rows, columns + 1] & ~free[rows, columns - 1]
    return bool((shut_x | shut_y).any())


def _mark_lanes(
    fee: Floats, tunnel: NDArray[np.bool_], free: NDArray[np.bool_], to_source: Floats, to_home: Floats
) -> None:
    """Raise the fee of the left lane, each direction's own left, in a tunnel of two or more cells' width.

    The lane follows from the walls beside a cell and beside the cells before and behind it, which also
    holds in bends: the inner corner belongs to the one direction, the outer to the other.
    """
    for direction, cost in ((INBOUND, to_source), (OUTBOUND, to_home)):
        for row, column in np.argwhere(tunnel).tolist():
            step_x, step_y = CARDINAL_STEPS[_downhill(cost, row, column)].tolist()
            right, left = (
                sum(
                    not free[row + side * step_x + along * step_y, column - side * step_y + along * step_x]
                    for along in (-1, 0, 1)
                )
                for side in (-1, 1)
            )
            if left == right:
                # Between the outer lanes, the nearer wall decides.
                right = -_reach(free, row, column, step_y, -step_x)
                left = -_reach(free, row, column, -step_y, step_x)
            if left >= right:
                fee[direction, row, column] = WRONG_LANE_COST if left > right else MIDDLE_LANE_COST


def _downhill(cost: Floats, row: int, column: int) -> int:
    """Return the action toward the neighbour with the least cost."""
    around = [cost[row + step_y, column + step_x] for step_x, step_y in CARDINAL_STEPS[:4].tolist()]
    return int(np.argmin(around))


def _reach(free: NDArray[np.bool_], row: int, column: int, step_x: int, step_y: int) -> int:
    """Return how many free cells lie in a direction before the next wall."""
    count = 0
    while free[row + step_y, column + step_x]:
        row, column, count = row + step_y, column + step_x, count + 1
    return count


def _straight_ahead_is_near(gate: Integers, free: NDArray[np.bool_]) -> Floats:
    """Return fees that make the cells straight ahead of a gated tunnel's mouth count half."""
    fee = np.ones(gate.shape)
    for row, column in np.argwhere(gate >= 0).tolist():
        for step_x, step_y in CARDINAL_STEPS[:4].tolist():
            y, x = row + step_y, column + step_x
            while free[y, x] and gate[y, x] < 0:
                fee[y, x] = 0.5
                y, x = y + step_y, x + step_x
    return fee


def _mouths(gate: Integers, free: NDArray[np.bool_], distance: Floats) -> Integers:
    """Return the number of the gated tunnel that a cell outside is within `MOUTH_REACH` of, or -1."""
    reach = gate.copy()
    for _ in range(2 * int(MOUTH_REACH)):
        grown = reach.copy()
        for step_x, step_y in CARDINAL_STEPS[:4].tolist():
            moved = np.roll(reach, (step_y, step_x), axis=(0, 1))
            grown = np.where((grown < 0) & free, moved, grown)
        reach = grown
    return np.where((gate < 0) & (distance <= MOUTH_REACH), reach, -1)
