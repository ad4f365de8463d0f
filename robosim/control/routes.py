"""Routes for controllers with full knowledge of the map: lanes in tunnels, and the way along them."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.robot.drivers import CARDINAL_STEPS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

WRONG_LANE_COST = 12.0
"""What a cell of the oncoming lane costs, in cells: taken only where there is no other way."""
INBOUND, OUTBOUND = 0, 1


@dataclass(frozen=True, slots=True)
class Routes:
    """Where to go from every cell, on a grid padded by one wall on each side."""

    cost: Floats
    """[2, rows + 2, columns + 2] cost to the source (inbound) and to the home (outbound); inf in walls."""
    zones: NDArray[np.uint8]
    """[rows + 2, columns + 2]."""
    gate: Integers
    """[rows + 2, columns + 2] number of the one-robot-wide tunnel that a cell belongs to, or -1."""
    mouth: Integers
    """[rows + 2, columns + 2] number of the one-robot-wide tunnel that begins within two cells, or -1."""
    gates: int
    """How many one-robot-wide tunnels carry traffic in both directions."""


def plan_routes(arena: Arena) -> Routes:
    """Work out lanes: keep to the right in a wide tunnel; of several tunnels, one way each where that helps."""
    zones = np.pad(arena.zones, 1, constant_values=int(Zone.WALL))
    free = zones != Zone.WALL
    to_source = _costs(free, zones == Zone.SOURCE, np.ones(zones.shape))
    to_home = _costs(free, zones == Zone.HOME, np.ones(zones.shape))
    tunnels = _components(zones == Zone.TUNNEL)
    count = int(tunnels.max()) + 1
    narrow = [_is_narrow(tunnels == tunnel, free) for tunnel in range(count)]
    fee = np.ones((2, *zones.shape))
    shared = list(range(count))
    if count > 1 and any(narrow):
        # One tunnel in, the others out: nobody meets anybody.
        first = min(shared, key=lambda tunnel: float(to_source[tunnels == tunnel].min()))
        for tunnel in range(count):
            fee[OUTBOUND if tunnel == first else INBOUND][tunnels == tunnel] = WRONG_LANE_COST
        shared = []
    for tunnel in shared:
        if not narrow[tunnel]:
            _mark_lanes(fee, tunnels == tunnel, free, to_source, to_home)
    gate = np.full(zones.shape, -1)
    gates = 0
    for tunnel in shared:
        if narrow[tunnel]:
            gate[tunnels == tunnel] = gates
            gates += 1
    cost = np.stack(
        [
            _costs(free, zones == Zone.SOURCE, fee[INBOUND]),
            _costs(free, zones == Zone.HOME, fee[OUTBOUND]),
        ]
    )
    return Routes(cost, zones, gate, _mouths(gate, free), gates)


def _costs(free: NDArray[np.bool_], goal: NDArray[np.bool_], fee: Floats) -> Floats:
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


def _components(mask: NDArray[np.bool_]) -> Integers:
    """Number the connected parts of a mask from 0; -1 outside."""
    label = np.full(mask.shape, -1)
    parts = 0
    for row, column in np.argwhere(mask).tolist():
        if label[row, column] >= 0:
            continue
        stack = [(row, column)]
        label[row, column] = parts
        while stack:
            y, x = stack.pop()
            for step_x, step_y in CARDINAL_STEPS[:4].tolist():
                neighbour = (y + step_y, x + step_x)
                if mask[neighbour] and label[neighbour] < 0:
                    label[neighbour] = parts
                    stack.append(neighbour)
        parts += 1
    return label


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
    """Raise the fee of the left lane, each direction's own left, in a tunnel of two or more cells' width."""
    for direction, cost in ((INBOUND, to_source), (OUTBOUND, to_home)):
        for row, column in np.argwhere(tunnel).tolist():
            step_x, step_y = min(
                CARDINAL_STEPS[:4].tolist(), key=lambda step: cost[row + step[1], column + step[0]]
            )
            right = _reach(free, row, column, step_y, -step_x)
            left = _reach(free, row, column, -step_y, step_x)
            if left < right:
                fee[direction, row, column] = WRONG_LANE_COST


def _reach(free: NDArray[np.bool_], row: int, column: int, step_x: int, step_y: int) -> int:
    """Return how many free cells lie in a direction before the next wall."""
    count = 0
    while free[row + step_y, column + step_x]:
        row, column, count = row + step_y, column + step_x, count + 1
    return count


def _mouths(gate: Integers, free: NDArray[np.bool_]) -> Integers:
    """Return the number of the gated tunnel whose mouth lies within two cells of a cell outside, or -1."""
    mouth = np.full(gate.shape, -1)
    reach = gate.copy()
    for _ in range(2):
        grown = reach.copy()
        for step_x, step_y in CARDINAL_STEPS[:4].tolist():
            moved = np.roll(reach, (step_y, step_x), axis=(0, 1))
            grown = np.where((grown < 0) & free, moved, grown)
        reach = grown
    outside = (reach >= 0) & (gate < 0)
    mouth[outside] = reach[outside]
    return mouth
