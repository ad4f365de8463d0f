"""The measurements once more, slow and plain: one decision, robot and pair at a time, from the definitions.

It shares nothing with robosim.analysis but the distances to home, which belong to the arena.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

WALL, TUNNEL = 0, 4
STOP = 4
ROBOT_ROBOT, ROBOT_WALL, ROBOT_PELLET = range(3)
NOWHERE, AT_HOME, AT_SOURCE = -1, 0, 1


class PlainRun:
    """Frames of one episode, and what is read off a single one of them."""

    def __init__(self, run: Any) -> None:
        self.arena, self.robots, self.frames = run.arena, run.robots, run.frames
        self.last = len(self.frames) - 1
        self.period = self.arena.timing.decision_period
        self.zones = self.arena.zones.tolist()
        self.rows, self.columns = len(self.zones), len(self.zones[0])
        self._find_tunnels()
        self.place = [[tuple(map(float, pose[:2])) for pose in frame.pose] for frame in self.frames]
        self.to_home = [[self.distance(place) for place in places] for places in self.place]
        self.inside = [[self.tunnel_of.get(self.cell(place), -1) for place in row] for row in self.place]

    def distance(self, place: tuple[float, float]) -> float:
        return float(self.arena.distances.sample(np.array(place))[0])

    def cell(self, place: tuple[float, float]) -> tuple[int, int]:
        """(row, column)"""
        return math.floor(place[1] / self.arena.cell_size), math.floor(place[0] / self.arena.cell_size)

    def _neighbours(self, cell: tuple[int, int]) -> list[tuple[int, int]]:
        row, column = cell
        around = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
        return [(r, c) for r, c in around if 0 <= r < self.rows and 0 <= c < self.columns]

    def _find_tunnels(self) -> None:
        """Number the connected parts of zone T in the order of their lowest, leftmost cells."""
        self.tunnel_of: dict[tuple[int, int], int] = {}
        self.count = 0
        for row in range(self.rows):
            for column in range(self.columns):
                if self.zones[row][column] != TUNNEL or (row, column) in self.tunnel_of:
                    continue
                waiting = [(row, column)]
                while waiting:
                    cell = waiting.pop()
                    if self.zones[cell[0]][cell[1]] == TUNNEL and cell not in self.tunnel_of:
                        self.tunnel_of[cell] = self.count
                        waiting += self._neighbours(cell)
                self.count += 1
        size = self.arena.cell_size
        self.home_end, self.length = [], []
        for tunnel in range(self.count):
            cells = [cell for cell, number in self.tunnel_of.items() if number == tunnel]
            away = [self.distance(((column + 0.5) * size, (row + 0.5) * size)) for row, column in cells]
            self.home_end.append(min(away) - 0.5 * size)
            self.length.append(max(away) - min(away) + size)
        steps = math.ceil(self.arena.robot.length / size)
        self.near_of = dict(self.tunnel_of)
        for _ in range(steps):
            for cell, tunnel in list(self.near_of.items()):
                for other in self._neighbours(cell):
                    if self.zones[other[0]][other[1]] != WALL:
                        self.near_of.setdefault(other, tunnel)

    def nearer_end(self, tunnel: int, distance: float) -> int:
        source_end = self.home_end[tunnel] + self.length[tunnel]
        home = abs(distance - self.home_end[tunnel]) < abs(distance - source_end)
        return AT_HOME if home else AT_SOURCE

    def contacts(self, step: int) -> list[tuple[float, int, int, int, float]]:
        """(time, kind, a, b, impulse)"""
        one = self.frames[step].contacts
        return list(
            zip(*(part.tolist() for part in (one.time, one.kind, one.a, one.b, one.impulse)), strict=True)
        )


def plain_visits(run: PlainRun) -> list[tuple[int, int, int, int, int, int, float]]:
    """(robot, tunnel, start, end, entered, left, deepest)"""
    found = []
    for robot in range(run.robots):
        step = 0
        while step <= run.last:
            tunnel = run.inside[step][robot]
            if tunnel < 0:
                step += 1
                continue
            end = step
            while end <= run.last and run.inside[end][robot] == tunnel:
                end += 1
            stay = [run.to_home[at][robot] for at in range(step, end)]
            entered = run.nearer_end(tunnel, stay[0]) if step > 0 else NOWHERE
            left = run.nearer_end(tunnel, run.to_home[end][robot]) if end <= run.last else NOWHERE
            begin = run.home_end[tunnel] + entered * run.length[tunnel] if entered >= 0 else stay[0]
            deepest = max(abs(distance - begin) for distance in stay)
            found.append((robot, tunnel, step, end, entered, left, deepest))
            step = end
    return sorted(found, key=lambda visit: (visit[3], visit[0]))


def is_passage(visit: tuple[int, int, int, int, int, int, float]) -> bool:
    return {visit[4], visit[5]} == {AT_HOME, AT_SOURCE}


def plain_windows(run: PlainRun, decisions: int) -> list[tuple[int, float, float]]:
    """(tunnel, density, flow) of every whole stretch of so many decisions"""
    found = []
    for begin in range(0, run.last - decisions + 1, decisions):
        for tunnel in range(run.count):
            time = approach = 0.0
            for step in range(begin + 1, begin + decisions + 1):
                for robot in range(run.robots):
                    if run.inside[step][robot] == tunnel:
                        time += run.period
                        gone = run.to_home[step][robot] - run.to_home[step - 1][robot]
                        approach += -gone if run.frames[step - 1].laden[robot] else gone
            area = run.length[tunnel] * decisions * run.period
            found.append((tunnel, time / area, approach / area))
    return found


def plain_activity(run: PlainRun, decisions: int) -> list[float]:
    found = []
    for begin in range(0, run.last - decisions + 1, decisions):
        span = range(begin + 1, begin + decisions + 1)
        been = [any(run.inside[step][robot] >= 0 for step in span) for robot in range(run.robots)]
        found.append(sum(been) / run.robots)
    return found


class PlainCounts:
    """Decisions counted, from 1 on."""

    def __init__(self, run: PlainRun, per_cell: int) -> None:
        self.robots_in_tunnel = [0] * (run.robots + 1)
        self.bidirectional = 0
        self.cells: dict[tuple[bool, int, int], int] = {}
        self.occupancy: dict[tuple[int, int], int] = {}
        self.stops = [0] * run.robots
        fine = run.arena.cell_size / per_cell
        for step in range(1, run.last + 1):
            frame = run.frames[step]
            there = [robot for robot in range(run.robots) if run.inside[step][robot] >= 0]
            self.robots_in_tunnel[len(there)] += 1
            least = 0.25 * run.arena.robot.top_speed * run.period
            moving = [
                robot
                for robot in there
                if abs(run.to_home[step][robot] - run.to_home[step - 1][robot]) >= least
            ]
            self.bidirectional += len({bool(frame.laden[robot]) for robot in moving}) == 2
            for robot in moving:
                key = (bool(frame.laden[robot]), *run.cell(run.place[step][robot]))
                self.cells[key] = self.cells.get(key, 0) + 1
            for robot in range(run.robots):
                x, y = run.place[step][robot]
                square = math.floor(y / fine), math.floor(x / fine)
                self.occupancy[square] = self.occupancy.get(square, 0) + 1
                self.stops[robot] += int(frame.action[robot]) == STOP


class PlainTallies:
    """Touches, impulse, energy and time in each mode, of one robot over decisions `begin` + 1 to `end`."""

    def __init__(self, run: PlainRun, robot: int, begin: int, end: int, modes: int) -> None:
        self.seconds = [0.0] * modes
        self.contacts = [0, 0, 0]
        self.impulse = 0.0
        for step in range(begin + 1, end + 1):
            self.seconds[int(run.frames[step].mode[robot])] += run.period
            touches = set()
            for time, kind, a, b, impulse in run.contacts(step):
                if robot not in ((a, b) if kind == ROBOT_ROBOT else (a,)):
                    continue
                if kind == ROBOT_ROBOT:
                    self.impulse += impulse * run.arena.timing.substeps
                touches.add((time, kind, a, b))
            for time, kind, a, b in touches:
                self.contacts[kind] += begins(run, (kind, a, b), time, step)
        self.energy = float(run.frames[end].energy[robot] - run.frames[begin].energy[robot])


def begins(run: PlainRun, pair: tuple[int, int, int], time: float, step: int) -> bool:
    """Whether the pair was not in contact within a decision's time before."""
    for before in range(max(0, step - 2), step + 1):
        for other, kind, a, b, _ in run.contacts(before):
            if (kind, a, b) == pair and 1e-9 < time - other <= run.period + 1e-9:
                return False
    return True


def plain_trips(run: PlainRun) -> list[tuple[int, int, int, int]]:
    """(robot, start, end, pellets)"""
    found = []
    for robot in range(run.robots):
        begin = 0
        for step in range(1, run.last + 1):
            more = int(run.frames[step].delivered[robot] - run.frames[step - 1].delivered[robot])
            if more:
                found.append((robot, begin, step, more))
                begin = step
    return sorted(found, key=lambda trip: (trip[2], trip[0]))


class PlainGroups:
    """Who is in a group after each decision."""

    def __init__(self, run: PlainRun, hold: int) -> None:
        self.run, self.hold = run, hold
        self.touches = [self._touches(step) for step in range(run.last + 1)]
        self.held = [
            [self._held_up(step, robot) for robot in range(run.robots)] for step in range(run.last + 1)
        ]
        self.groups = [self._groups(step) for step in range(run.last + 1)]

    def _touches(self, step: int) -> tuple[set[int], set[frozenset[int]]]:
        """Who touched a loose pellet, and which two touched each other or the same pellet."""
        pressed, linked = set(), set()
        at: dict[int, set[int]] = {}
        for _, kind, a, b, _ in self.run.contacts(step):
            if kind == ROBOT_ROBOT:
                linked.add(frozenset((a, b)))
            if kind == ROBOT_PELLET:
                pressed.add(a)
                at.setdefault(b, set()).add(a)
        for robots in at.values():
            linked |= {frozenset((one, two)) for one in robots for two in robots if one != two}
        return pressed, linked

    def _window(self, step: int) -> range:
        return range(step - self.hold + 1, step + 1)

    def _held_up(self, step: int, robot: int) -> bool:
        if step < self.hold:
            return False
        here, there = self.run.place[step][robot], self.run.place[step - self.hold][robot]
        if math.dist(here, there) >= 0.5 * self.run.arena.robot.length:
            return False
        moving = sum(int(self.run.frames[at].action[robot]) != STOP for at in self._window(step))
        return moving >= self.hold / 2

    def linked(self, step: int, one: int, two: int) -> bool:
        pair = frozenset((one, two))
        both = self.held[step][one] and self.held[step][two]
        return one != two and both and any(pair in self.touches[at][1] for at in self._window(step))

    def pressed(self, step: int, robot: int) -> bool:
        return self.held[step][robot] and any(robot in self.touches[at][0] for at in self._window(step))

    def near(self, step: int, robot: int) -> int:
        return self.run.near_of.get(self.run.cell(self.run.place[step][robot]), -1)

    def _groups(self, step: int) -> list[list[int]]:
        """In the order of their lowest members."""
        left = [robot for robot in range(self.run.robots) if self.held[step][robot]]
        found = []
        while left:
            group, waiting = set(), [left[0]]
            while waiting:
                one = waiting.pop()
                group.add(one)
                waiting += [two for two in left if two not in group and self.linked(step, one, two)]
            left = [robot for robot in left if robot not in group]
            if not any(self.near(step, robot) >= 0 for robot in group):
                continue
            if len(group) >= 2 or any(self.pressed(step, robot) for robot in group):
                found.append(sorted(group))
        return found


class PlainStay:
    def __init__(self, start: int, tunnel: int, group: list[int]) -> None:
        self.start, self.since, self.tunnel = start, start, tunnel
        self.recognised = -1
        self.members = set(group)
        self.seen: dict[int, int] = {}
        self.standing: set[int] = set()
        self.stood: set[int] = set()
        self.last = -1
        self.shut = False
        self.onset: tuple[str, tuple[float, float], float] = ("", (0.0, 0.0), 0.0)


class PlainClogs:
    """Stays of groups, decision by decision, and the pieces that passages cut them into."""

    def __init__(self, run: PlainRun, hold: int, shortest: float) -> None:
        self.run, self.hold, self.shortest = run, hold, shortest
        self.groups = PlainGroups(run, hold)
        self.stays: list[PlainStay] = []
        self.found: list[dict[str, Any]] = []
        self.shut: dict[int, int] = {}
        self.passages = [(visit[2], visit[3], visit[1]) for visit in plain_visits(run) if is_passage(visit)]
        for step in range(run.last + 1):
            self._decision(step)
        for stay in self.stays:
            self._end(stay, "RUN_ENDED", stay.last + 1)
        self.found.sort(key=lambda clog: (clog["start"], clog["end"], clog["members"]))

    def _decision(self, step: int) -> None:
        for stay in self.stays:
            stay.standing = set()
        for group in self.groups.groups[step]:
            self._place(step, group)
        for begin, end, tunnel in self.passages:
            if end == step:
                self._passage(begin, step, tunnel)
        for stay in list(self.stays):
            if stay.standing:
                if step <= stay.recognised + self.hold:
                    causes = ["HEAD_ON", "PELLET", "TURNING", "QUEUE"]
                    foremost = min(self._cause(step, sorted(stay.standing)), stay.onset[0], key=causes.index)
                    stay.onset = (foremost, *stay.onset[1:])
                stay.last, stay.stood = step, set(stay.standing)
                for robot in stay.standing:
                    stay.seen[robot] = step
            elif step - stay.last == self.hold:
                self._end(stay, self._how(step, stay), stay.last + 1)
                self.stays.remove(stay)

    def _place(self, step: int, group: list[int]) -> None:
        """A group goes on with the stays that one of its robots was in less than the hold ago."""
        mine = [
            stay
            for stay in self.stays
            if not stay.shut
            and any(robot in stay.seen and step - stay.seen[robot] - 1 < self.hold for robot in group)
        ]
        if not mine:
            tunnel = max(self.groups.near(step, robot) for robot in group)
            stay = PlainStay(max(step - self.hold, self.shut.get(tunnel, 0)), tunnel, group)
            stay.onset, stay.recognised = self._onset(step, group), step
            self.stays.append(stay)
        else:
            stay = min(mine, key=lambda one: one.start)
            for other in mine:
                if other is not stay:
                    stay.since = min(stay.since, other.since)
                    stay.members |= other.members
                    stay.standing |= other.standing
                    for robot, seen in other.seen.items():
                        stay.seen[robot] = max(seen, stay.seen.get(robot, -1))
                    self.stays.remove(other)
        stay.members |= set(group)
        stay.standing |= set(group)
        for robot in group:
            stay.seen[robot] = step

    def _passage(self, begin: int, step: int, tunnel: int) -> None:
        for stay in self.stays:
            if stay.tunnel != tunnel or begin < stay.since:
                continue
            if not stay.standing:
                stay.shut = True
                self.shut[stay.tunnel] = step
            elif stay.start < step:
                self._end(stay, "PASSAGE", step)
                stay.start, stay.members = step, set(stay.standing)
                stay.onset, stay.recognised = self._onset(step, sorted(stay.standing)), step

    def _onset(self, step: int, group: list[int]) -> tuple[str, tuple[float, float], float]:
        places = [self.run.place[step][robot] for robot in group]
        x, y = (sum(place[axis] for place in places) / len(group) for axis in (0, 1))
        distance = sum(self.run.to_home[step][robot] for robot in group) / len(group)
        return self._cause(step, group), (x, y), distance

    def _cause(self, step: int, group: list[int]) -> str:
        away, laden = self.run.to_home[step], self.run.frames[step].laden
        apart = 0.25 * self.run.arena.robot.length
        for out in group:
            for back in group:
                opposite = self.groups.linked(step, out, back) and laden[back] and not laden[out]
                if opposite and away[back] - away[out] > apart:
                    return "HEAD_ON"
        if any(self.groups.pressed(step, robot) for robot in group):
            return "PELLET"
        return "TURNING" if any(self._across(step, robot) for robot in group) else "QUEUE"

    def _across(self, step: int, robot: int) -> bool:
        if self.run.inside[step][robot] < 0:
            return False
        (x, y), heading = self.run.place[step][robot], float(self.run.frames[step].pose[robot, 2])
        tiny = 0.25 * self.run.arena.cell_size
        slope_x = self.run.distance((x + tiny, y)) - self.run.distance((x - tiny, y))
        slope_y = self.run.distance((x, y + tiny)) - self.run.distance((x, y - tiny))
        along = slope_x * math.cos(heading) + slope_y * math.sin(heading)
        return abs(along) < 0.5 * math.hypot(slope_x, slope_y)

    def _how(self, step: int, stay: PlainStay) -> str:
        for robot in stay.stood:
            for at in range(max(1, stay.last - self.hold + 1), step + 1):
                if self.run.frames[at].laden[robot] and not self.run.frames[at - 1].laden[robot]:
                    return "TOOK_PELLET"
        outward = {
            robot: self.run.to_home[step][robot] - self.run.to_home[stay.last][robot] for robot in stay.stood
        }
        most = max(sorted(outward), key=lambda robot: abs(outward[robot]))
        if abs(outward[most]) < 0.5 * self.run.arena.robot.length:
            return "LET_GO"
        homeward = outward[most] < 0.0
        laden = bool(self.run.frames[stay.last].laden[most])
        return "WENT_ON" if homeward == laden else "BACKED_OFF"

    def _end(self, stay: PlainStay, ending: str, end: int) -> None:
        transit = self.run.length[stay.tunnel] / self.run.arena.robot.top_speed
        transits = (end - stay.start) * self.run.period / transit
        if transits >= self.shortest:
            cause, place, distance = stay.onset
            self.found.append(
                {
                    "tunnel": stay.tunnel,
                    "start": stay.start,
                    "end": end,
                    "members": tuple(sorted(stay.members)),
                    "cause": cause,
                    "ending": ending,
                    "place": place,
                    "distance": distance,
                    "transits": transits,
                }
            )
