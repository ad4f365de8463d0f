"""The Dec-POMDP once more, slow and plain: one environment, robot and cell at a time, from the definitions.

It shares nothing with robosim.discretise; the numbers of the definitions are written out again.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

WALL, FLOOR, HOME, SOURCE, TUNNEL = range(5)
GOING_TO_DIG, DIGGING, EXIT_DIGGING, GOING_HOME, DUMPING, EXIT_HOME, COLLISION = range(7)
MODE_NAMES = ("going_to_dig", "digging", "exit_digging", "going_home", "dumping", "exit_home", "collision")
STOP = 4
COMPASS = {
    "N": (0, 1), "S": (0, -1), "W": (-1, 0), "E": (1, 0),
    "NW": (-1, 1), "NE": (1, 1), "SW": (-1, -1), "SE": (1, -1),
}  # fmt: skip
ACTION_NAMES = {
    "cardinal": ("north", "south", "west", "east", "stop"),
    "wheels": ("forward", "back", "spin left", "spin right", "stop"),
    "wheels-9": (
        "forward", "back", "spin left", "spin right", "stop",
        "bear left", "bear right", "back left", "back right",
    ),
}  # fmt: skip
OWN_SIDES = {
    "ahead": (1, 0), "behind": (-1, 0), "left": (0, 1), "right": (0, -1),
    "ahead left": (1, 1), "ahead right": (1, -1), "behind left": (-1, 1), "behind right": (-1, -1),
}  # fmt: skip


def mode_of(zone: int, laden: bool, at_pellet: bool) -> int:
    """The mode of a robot that is not blocked."""
    if laden:
        if zone == SOURCE:
            return EXIT_DIGGING
        return DUMPING if zone == HOME else GOING_HOME
    if zone == HOME:
        return EXIT_HOME
    if zone == SOURCE or at_pellet:
        return DIGGING
    return GOING_TO_DIG


def reward_of(
    gained: float,
    collided: bool,
    laden: bool,
    pickups: float,
    deliveries: float,
    idle: bool = False,
    *,
    signed: bool = False,
    idle_cost: bool = False,
) -> float:
    """r = w_d r_d + w_c r_c + w_p r_p + w_s r_s with the paper's numbers; top speed gains 1."""
    paid = max(-1.0, min(1.0, gained)) if signed else float(gained > 0.1)
    reward = 0.2 * 2.5 * paid
    if collided and not laden:
        reward += 0.2 * -2.0
    if idle_cost and idle:
        reward -= 0.5
    return reward + 0.2 * 50.0 * pickups + 0.4 * 50.0 * deliveries


class PlainMap:
    """The pheromone map of one environment, a dictionary entry for every free cell (column, row)."""

    def __init__(self, zones: Any, config: Any, actions: int = 5) -> None:
        self.config, self.actions = config, actions
        self.rows, self.columns = len(zones), len(zones[0])
        self.free = [
            (column, row)
            for row in range(self.rows)
            for column in range(self.columns)
            if zones[row][column] != WALL
        ]
        self.occupancy = dict.fromkeys(self.free, config.initial)
        self.marks: dict[tuple[int, int], tuple[float, float, float]] = {}

    def update(self, visits: list[tuple[tuple[int, int], int, bool, int]]) -> None:
        """One decision; a visit is (cell, shown mode, laden, action), robots in order."""
        alpha, beta, flow = self.config.decay, self.config.reinforcement, self.config.diffusion
        visited = {cell for cell, *_ in visits}
        rho = {
            cell: (1.0 - alpha) * self.occupancy[cell] + (beta if cell in visited else 0.0)
            for cell in self.free
        }
        for cell, mode, laden, action in visits:
            self.marks[cell] = ((mode + 1) / 7, float(laden), (action + 1) / self.actions)
        self.occupancy = {}
        for column, row in self.free:
            here = rho[column, row]
            new = here
            for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                there = rho.get((column + step[0], row + step[1]))
                if there is not None:
                    new += flow * (there - here)
            self.occupancy[column, row] = new

    def read(self, cell: tuple[int, int]) -> tuple[float, float, float, float]:
        """Occupancy and marks as a robot reads them; 0 where there is no free cell."""
        if cell not in self.occupancy:
            return 0.0, 0.0, 0.0, 0.0
        strength = min(self.occupancy[cell] / (self.config.reinforcement / self.config.decay), 1.0)
        mode, laden, action = self.marks.get(cell, (0.0, 0.0, 0.0))
        return strength, mode * strength, laden * strength, action * strength


class PlainRobot:
    """What one robot remembers between decisions."""

    def __init__(self) -> None:
        self.mode = self.shown = 0
        self.laden = self.blocked = self.collided = False
        self.collisions = self.nearest = self.in_place = 0
        self.action = STOP
        self.pose = (0.0, 0.0, 0.0)
        self.left = (0.0, 0.0)
        self.cell = (0, 0)
        self.to_home = self.to_source = 0.0


class PlainDecPomdp:
    """One environment; `moment` is a recorded one (see recorded.py), `env` which of its batch."""

    def __init__(self, run: Any, env: int) -> None:
        self.run, self.env = run, env
        self.arena, self.layout = run.arena, run.layout
        self.zones = self.arena.zones.tolist()
        self.robots = [PlainRobot() for _ in range(run.robots)]
        self.map = PlainMap(self.zones, run.pheromone, len(ACTION_NAMES[run.layout.actions]))
        self.paid: set[int] = set()
        self.to_goal: dict[tuple[int, int], list[float]] = {}
        self.farthest = float(self.arena.distances.raster.max())
        self._look(run.start)
        for robot in self.robots:
            robot.left = robot.pose[:2]

    def _look(self, moment: Any) -> None:
        size = self.arena.cell_size
        self.pellets, self.status = moment.pellets[self.env], moment.pellet_status[self.env]
        for index, robot in enumerate(self.robots):
            robot.nearest = int(moment.nearest[self.env, index])
            x, y, heading = moment.pose[self.env, index].tolist()
            robot.pose = (x, y, heading)
            robot.cell = (math.floor(x / size), math.floor(y / size))
            robot.laden = bool(moment.held[self.env, index] >= 0)
            zone = self.zones[robot.cell[1]][robot.cell[0]]
            robot.mode = mode_of(zone, robot.laden, bool(moment.touching[self.env, index] >= 0))
            robot.shown = robot.mode
            distances = self.arena.distances.sample(moment.pose[self.env, index, :2])
            robot.to_home, robot.to_source = float(distances[0]), float(distances[1])

    def update(self, moment: Any) -> list[float]:
        """Take in one decision; returns the rewards."""
        env, arena = self.env, self.arena
        top, period = arena.robot.top_speed, arena.timing.decision_period
        before = [(r.pose, r.laden, r.mode, r.to_home, r.to_source) for r in self.robots]
        self._look(moment)
        self.paid -= {pellet for pellet, fresh in enumerate(moment.fresh[env].tolist()) if fresh}
        pickups = [self._first_pickup(moment, index, before[index][1]) for index in range(len(self.robots))]
        deliveries = [float(count) for count in moment.deliveries[env]]
        if self.run.reward == "global":
            share = len(self.robots) if self.run.sharing == "split" else 1
            pickups = [sum(pickups) / share] * len(self.robots)
            deliveries = [sum(deliveries) / share] * len(self.robots)
        rewards = []
        for index, robot in enumerate(self.robots):
            (x, y, heading), was_laden, was_mode, to_home, to_source = before[index]
            robot.action = int(moment.actions[env, index])
            displacement = math.hypot(robot.pose[0] - x, robot.pose[1] - y)
            turned = abs(math.remainder(robot.pose[2] - heading, 2.0 * math.pi))
            stands = displacement < 0.25 * top * period
            if self.layout.actions != "cardinal" and self.layout.encoding == "expanded":
                stays = math.dist(robot.pose[:2], robot.left) < arena.cell_size
            else:
                stays = stands
            robot.in_place = robot.in_place + 1 if stays else 0
            if not stays:
                robot.left = robot.pose[:2]
            still = displacement < 0.25 * top * period and turned < 0.25 * arena.robot.top_turn_rate * period
            robot.blocked = robot.action != STOP and still and any(moment.touched[:, env, index])
            robot.collided = robot.action != STOP and bool(moment.touched[0, env, index])
            robot.collisions = (robot.collisions if robot.mode == was_mode else 0) + int(robot.collided)
            if robot.blocked:
                robot.shown = COLLISION
            gain = to_home - robot.to_home if was_laden else to_source - robot.to_source
            signals = robot.collided, was_laden, pickups[index], deliveries[index], stands
            switches = {"signed": self.run.signed_distance, "idle_cost": self.run.idle_cost}
            rewards.append(reward_of(gain / (top * period), *signals, **switches))
        self.map.update([(robot.cell, robot.shown, robot.laden, robot.action) for robot in self.robots])
        return rewards

    def _first_pickup(self, moment: Any, index: int, was_laden: bool) -> float:
        pellet = int(moment.held[self.env, index])
        if was_laden or pellet < 0 or pellet in self.paid:
            return 0.0
        self.paid.add(pellet)
        return 1.0

    @property
    def density(self) -> float:
        inside = sum(self.zones[robot.cell[1]][robot.cell[0]] == TUNNEL for robot in self.robots)
        return inside / self.arena.tunnel_length if self.arena.tunnel_length else 0.0

    def observation(self, robot: PlainRobot) -> dict[str, float]:
        """The robot's observation by name."""
        x, y, heading = robot.pose
        width, height = self.arena.size
        seen = {
            "x": x / width,
            "y": y / height,
            "collisions": min(robot.collisions, 20) / 20,
            "distance to home": robot.to_home / self.farthest,
            "distance to source": robot.to_source / self.farthest,
        }
        if self.layout.encoding == "paper":
            seen |= {
                "mode": robot.shown / 6,
                "heading": heading / math.pi,
                "previous action": robot.action / 4,
            }
        else:
            seen |= self._expanded(robot)
        if self.layout.stigmergy:
            reach = range(-self.layout.radius, self.layout.radius + 1)
            quarters = round(heading / (0.5 * math.pi))
            for dy in reach:
                for dx in reach:
                    step, place = (dx, dy), f"({dx:+d}, {dy:+d})"
                    if self.layout.actions != "cardinal" and self.layout.encoding == "expanded":
                        place = f"({dx:+d} ahead, {dy:+d} left)"
                        for _ in range(quarters % 4):
                            step = (-step[1], step[0])
                    values = self.map.read((robot.cell[0] + step[0], robot.cell[1] + step[1]))
                    for channel, value in zip(("occupancy", "mode", "laden", "action"), values, strict=True):
                        seen[f"{channel} {place}"] = value
            seen["tunnel density"] = min(self.density, 1.0)
        return seen

    def _expanded(self, robot: PlainRobot) -> dict[str, float]:
        x, y, heading = robot.pose
        size = self.arena.cell_size
        column, row = robot.cell
        seen = {
            "heading sine": math.sin(heading),
            "heading cosine": math.cos(heading),
            "offset in cell x": (x - (column + 0.5) * size) / (0.5 * size),
            "offset in cell y": (y - (row + 0.5) * size) / (0.5 * size),
            "laden": float(robot.laden),
            "in place": robot.in_place % 20 / 20,
        }
        seen |= {f"mode {name}": float(robot.shown == mode) for mode, name in enumerate(MODE_NAMES)}
        actions = ACTION_NAMES[self.layout.actions]
        seen |= {
            f"previous action {name}": float(robot.action == index) for index, name in enumerate(actions)
        }
        if self.layout.actions != "cardinal":
            return seen | self._own_sides(robot) | self._pellet(robot)
        others = {other.cell for other in self.robots if other is not robot}
        for side, (dx, dy) in COMPASS.items():
            cell = (column + dx, row + dy)
            seen[f"free {side}"] = float(self.zones[cell[1]][cell[0]] != WALL and cell not in others)
        for side in "NSWE":
            dx, dy = COMPASS[side]
            for goal, name in enumerate(("gain home", "gain source")):
                gain = self._to_goal(column, row)[goal] - self._to_goal(column + dx, row + dy)[goal]
                wall = self.zones[row + dy][column + dx] == WALL
                seen[f"{name} {side}"] = -1.0 if wall else max(-1.0, min(gain / size, 1.0))
        return seen | self._pellet(robot)

    def _own_sides(self, robot: PlainRobot) -> dict[str, float]:
        """What is one cell's length ahead, behind, to the left and so on, whatever the heading."""
        x, y, heading = robot.pose
        size = self.arena.cell_size
        sheet = self.arena.robot
        body = max(sheet.length, sheet.width)
        others = [other.pose for other in self.robots if other is not robot]
        seen = {}
        for side, (ahead, left) in OWN_SIDES.items():
            angle = heading + math.atan2(left, ahead)
            reach = size * math.hypot(ahead, left)
            px, py = x + reach * math.cos(angle), y + reach * math.sin(angle)
            column, row = math.floor(px / size), math.floor(py / size)
            inside = 0 <= row < len(self.zones) and 0 <= column < len(self.zones[0])
            wall = not inside or self.zones[row][column] == WALL
            near = any(math.hypot(px - other[0], py - other[1]) < body for other in others)
            seen[f"free {side}"] = float(not wall and not near)
            if ahead and left:
                continue
            there = self.arena.distances.sample(np.array([px, py])).tolist()
            for goal, here in enumerate((robot.to_home, robot.to_source)):
                gain = max(-1.0, min((here - there[goal]) / size, 1.0))
                seen[f"gain {('home', 'source')[goal]} {side}"] = -1.0 if wall else gain
        return seen

    def _to_goal(self, column: int, row: int) -> list[float]:
        """Distances to home and source, in m, at a cell's centre."""
        if (column, row) not in self.to_goal:
            centre = np.array([column + 0.5, row + 0.5]) * self.arena.cell_size
            self.to_goal[column, row] = self.arena.distances.sample(centre).tolist()
        return self.to_goal[column, row]

    def _pellet(self, robot: PlainRobot) -> dict[str, float]:
        """The pellet nearest to the gripper, if it lies within two cells to each side and is loose."""
        x, y = (self.pellets[robot.nearest][axis] - robot.pose[axis] for axis in (0, 1))
        sight = 2.0 * self.arena.cell_size
        axes = "x", "y"
        if self.layout.actions != "cardinal":
            axes = "ahead", "left"
            bearing, apart = math.atan2(y, x) - robot.pose[2], math.hypot(x, y)
            x, y = apart * math.cos(bearing), apart * math.sin(bearing)
        if self.status[robot.nearest] != 0 or max(abs(x), abs(y)) > sight:
            return {"pellet seen": 0.0, f"pellet {axes[0]}": 0.0, f"pellet {axes[1]}": 0.0}
        return {"pellet seen": 1.0, f"pellet {axes[0]}": x / sight, f"pellet {axes[1]}": y / sight}
