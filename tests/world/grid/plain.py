"""The grid world once more, slowly: one environment, plain Python, dictionaries."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robosim.arena.model import Arena, Zone
from robosim.world.draws import draw_episode
from robosim.world.grid.layout import grid_arena

Cell = tuple[int, int]
"""(column, row)."""
COMPASS = {0: (0, 1), 1: (0, -1), 2: (-1, 0), 3: (1, 0)}
QUARTERS = [(1, 0), (0, 1), (-1, 0), (0, -1)]
RADIANS = [0.0, 0.5 * math.pi, -math.pi, -0.5 * math.pi]
DRAWN_AT_ONCE = 64


def settled(
    cells: list[Cell], targets: list[Cell], order: list[int], free: set[Cell]
) -> tuple[list[bool], list[bool], list[bool]]:
    """Return who moves, who is refused by a wall, and who by a robot; of rivals the last in `order` goes."""
    robots = range(len(cells))
    at = {cell: robot for robot, cell in enumerate(cells)}
    wants = [targets[robot] != cells[robot] for robot in robots]
    walled = [wants[robot] and targets[robot] not in free for robot in robots]

    def exchanges(robot: int) -> bool:
        other = at.get(targets[robot])
        return other is not None and other != robot and targets[other] == cells[robot]

    rivals: dict[Cell, list[int]] = {}
    for robot in order:
        if wants[robot] and not walled[robot] and not exchanges(robot):
            rivals.setdefault(targets[robot], []).append(robot)

    def goes(robot: int, behind: tuple[int, ...] = ()) -> bool:
        if rivals.get(targets[robot], [None])[-1] != robot:
            return False
        ahead = at.get(targets[robot])
        return ahead is None or ahead in (*behind, robot) or goes(ahead, (*behind, robot))

    moved = [goes(robot) for robot in robots]
    met = [wants[robot] and not walled[robot] and not moved[robot] for robot in robots]
    return moved, walled, met


class PlainGrid:
    """One environment; `state()` has the fields of WorldState without the first axis."""

    def __init__(self, arena: Arena, robots: int, seed: np.random.SeedSequence, actions: str) -> None:
        self.arena = arena = grid_arena(arena)
        self.robots = robots
        self.wheels = actions == "wheels"
        self.rng = np.random.default_rng(seed)
        draws, _ = draw_episode(arena, robots, self.rng)
        zones = arena.zones
        self.zone = {
            (column, row): Zone(int(zones[row, column]))
            for row in range(arena.rows)
            for column in range(arena.columns)
        }
        self.free = {cell for cell, zone in self.zone.items() if zone != Zone.WALL}
        self.cells = [self.cell_of(x, y) for x, y, _ in draws.robot_pose.tolist()]
        turns = [2.0 * heading / math.pi for heading in draws.robot_pose[:, 2].tolist()]
        self.quarter = [round(turn) % 4 for turn in turns]
        self.place: dict[int, tuple[float, float]] = {
            pellet: (x, y) for pellet, (x, y) in enumerate(draws.pellet_place.tolist())
        }
        self.spot: dict[int, int] = dict(enumerate(draws.pellet_spot.tolist()))
        self.lies_in = {pellet: self.cell_of(*self.place[pellet]) for pellet in self.place}
        self.held: dict[int, int] = {}
        self.absent: set[int] = set()
        self.refused = [False] * robots
        self.delivered = self.refilled = self.decisions = 0
        self.lots: list[tuple[list[int], list[float]]] = []
        self.clear()

    def clear(self) -> None:
        self.picked = [-1] * self.robots
        self.deliveries = [0] * self.robots
        self.fresh: set[int] = set()
        self.touched = [[False] * self.robots for _ in range(3)]
        self.contacts: list[tuple[Any, ...]] = []
        self.velocity = [(0.0, 0.0, 0.0)] * self.robots

    def cell_of(self, x: float, y: float) -> Cell:
        per_cell = 1.0 / self.arena.cell_size
        return int(x * per_cell), int(y * per_cell)

    def middle(self, cell: Cell) -> tuple[float, float]:
        size = self.arena.cell_size
        return (cell[0] + 0.5) * size, (cell[1] + 0.5) * size

    def nose(self, robot: int) -> tuple[float, float]:
        reach = min(0.5 * self.arena.robot.length, 0.45 * self.arena.cell_size)
        (x, y), (dx, dy) = self.middle(self.cells[robot]), QUARTERS[self.quarter[robot]]
        return x + reach * dx, y + reach * dy

    def draw(self) -> tuple[list[int], list[float]]:
        if not self.lots:
            numbers = self.rng.random((DRAWN_AT_ONCE, 2, self.robots))
            self.lots = [(np.argsort(order).tolist(), chance.tolist()) for order, chance in numbers]
        return self.lots.pop(0)

    def wish(self, robot: int, action: int) -> tuple[Cell, int]:
        """Return the wanted cell, and the heading once there."""
        (column, row), quarter = self.cells[robot], self.quarter[robot]
        step = (0, 0)
        if self.wheels:
            ahead = QUARTERS[quarter]
            step = {0: ahead, 1: (-ahead[0], -ahead[1])}.get(action, step)
            quarter = (quarter + {2: 1, 3: -1}.get(action, 0)) % 4
        elif action in COMPASS:
            step = COMPASS[action]
            quarter = QUARTERS.index(step)
        return (column + step[0], row + step[1]), quarter

    def step(self, actions: list[int], gripper: list[int]) -> None:
        self.clear()
        self.decisions += 1
        order, chance = self.draw()
        wishes = [self.wish(robot, action) for robot, action in enumerate(actions)]
        targets = [target for target, _ in wishes]
        was = list(self.cells)
        moved, walled, met = settled(was, targets, order, self.free)
        for robot, (target, quarter) in enumerate(wishes):
            period = self.arena.timing.decision_period
            turn = 0.0
            if not walled[robot] and not met[robot]:
                turn = RADIANS[quarter] - RADIANS[self.quarter[robot]]
                turn -= 2.0 * math.pi * round(turn / (2.0 * math.pi))
                self.quarter[robot] = quarter
            if moved[robot]:
                self.cells[robot] = target
            (x0, y0), (x1, y1) = self.middle(was[robot]), self.middle(self.cells[robot])
            self.velocity[robot] = ((x1 - x0) / period, (y1 - y0) / period, turn / period)
            self.refused[robot] = (self.refused[robot] or walled[robot] or met[robot]) and not moved[robot]
        self.touched = [met, walled, [False] * self.robots]
        self.list_contacts(was, targets, walled, met)
        self.handle(gripper, chance)

    def list_contacts(
        self, was: list[Cell], targets: list[Cell], walled: list[bool], met: list[bool]
    ) -> None:
        at = {cell: robot for robot, cell in enumerate(self.cells)}
        exchanged = set()
        for robot in range(self.robots):
            (x0, y0), (x1, y1) = self.middle(was[robot]), self.middle(targets[robot])
            border = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
            if walled[robot]:
                self.contacts.append((1, robot, -1, *border))
            if met[robot]:
                other = at[targets[robot]]
                pair = (min(robot, other), max(robot, other))
                if pair in exchanged:
                    continue
                if met[other] and targets[other] == was[robot]:
                    exchanged.add(pair)
                self.contacts.append((0, *pair, *border))

    def handle(self, gripper: list[int], chance: list[float]) -> None:
        for robot, pellet in list(self.held.items()):
            self.place[pellet] = self.nose(robot)
            if gripper[robot] == -1:
                del self.held[robot]
                if self.zone[self.cells[robot]] == Zone.HOME:
                    self.deliveries[robot] += 1
                    self.delivered += 1
                    self.absent.add(pellet)
                else:
                    self.lies_in[pellet] = self.cells[robot]
        places = self.arena.pellet_places.tolist()
        for pellet, lot in zip(sorted(self.absent)[: self.robots], chance, strict=False):
            used = set(self.spot.values())
            room = [
                spot
                for spot, place in enumerate(places)
                if spot not in used and self.cell_of(*place) not in self.cells
            ]
            if not room:
                break
            spot = room[int(lot * len(room))]
            self.absent.remove(pellet)
            self.place[pellet] = tuple(places[spot])
            self.spot[pellet] = spot
            self.lies_in[pellet] = self.cell_of(*places[spot])
            self.fresh.add(pellet)
            self.refilled += 1
        for robot in range(self.robots):
            touched = self.touching(robot)
            if gripper[robot] == 1 and touched >= 0:
                self.held[robot] = self.picked[robot] = touched
                del self.lies_in[touched]
                self.spot.pop(touched, None)
                self.place[touched] = self.nose(robot)

    def distance(self, robot: int, pellet: int) -> float:
        (x, y), (px, py) = self.nose(robot), self.place[pellet]
        return (px - x) * (px - x) + (py - y) * (py - y)

    def touching(self, robot: int) -> int:
        here = [pellet for pellet, cell in sorted(self.lies_in.items()) if cell == self.cells[robot]]
        if robot in self.held or not here:
            return -1
        return min(here, key=lambda pellet: self.distance(robot, pellet))

    def nearest(self, robot: int) -> int:
        loose = sorted(self.lies_in)
        here = [pellet for pellet in loose if self.lies_in[pellet] == self.cells[robot]]
        return min(here or loose or [0], key=lambda pellet: self.distance(robot, pellet))

    def state(self) -> dict[str, Any]:
        every, pellets = range(self.robots), range(len(self.place))
        status = {True: 0}
        return {
            "pose": [(*self.middle(self.cells[r]), RADIANS[self.quarter[r]]) for r in every],
            "velocity": self.velocity,
            "held": [self.held.get(r, -1) for r in every],
            "nearest": [self.nearest(r) for r in every],
            "touching": [self.touching(r) for r in every],
            "pellets": [self.place[p] for p in pellets],
            "pellet_status": [status.get(p in self.lies_in, 2 if p in self.absent else 1) for p in pellets],
            "touched": self.touched,
            "picked": self.picked,
            "lost": [False] * self.robots,
            "deliveries": self.deliveries,
            "delivered": self.delivered,
            "refilled": self.refilled,
            "fresh": [p in self.fresh for p in pellets],
            "refused": self.refused,
        }
