"""Frames made by hand, in which everything that a monitor looks at is scripted, and frames of real runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import strategies as st

from robosim.analysis.measure.monitor import Episode, EpisodeMonitor
from robosim.arena import Arena, load_arena, parse_arena
from robosim.control.controller import make_controller
from robosim.discretise.modes import Mode
from robosim.envs.vector import VectorEnv
from robosim.episodes.columns import FrameColumns
from robosim.episodes.frame import Frame
from robosim.world.contacts import ContactKind, Contacts

STOP = 4
PERIOD = 0.3
"""Of a decision in all arenas used here, s."""
HOLD = 10
"""Decisions in 3 s."""
ROOM = 0.15
"""A cell of the shipped arenas used here, m."""
TOP = 0.06
"""Distance in a decision at top speed, m."""
LENGTH = 0.11
"""Of a robot, m."""

SMALL = '''
name = "small"
cell_size = 0.15
map = """
#########
#H.TT.SS#
#H.##.SS#
#H.TTT..#
#########
"""
[pellets]
count = 3
'''
"""Two short tunnels, so that every standstill is long enough to be kept."""
OPEN = SMALL.replace("TTT", "...").replace("TT", "..").replace("small", "open")
"""No tunnel at all."""


def middle(column: float, row: float) -> tuple[float, float]:
    """The middle of a cell of a shipped arena, m; parts of cells allowed."""
    return (column + 0.5) * ROOM, (row + 0.5) * ROOM


class Script:
    """A run of decisions 0 to `steps`; robots stand in the home and decide to stop unless it says otherwise.

    Its arrays are [steps + 1, robots, ...], to be written into.
    """

    def __init__(self, arena: Arena | str, robots: int, steps: int) -> None:
        self.arena = load_arena(arena) if isinstance(arena, str) else arena
        self.robots, self.steps = robots, steps
        shape = (steps + 1, robots)
        self.pose = np.zeros((*shape, 3))
        self.pose[..., 0] = 1.5 * self.arena.cell_size
        self.pose[..., 1] = 1.5 * self.arena.cell_size
        self.mode = np.full(shape, Mode.EXIT_HOME, dtype=np.uint8)
        self.laden = np.zeros(shape, dtype=np.bool_)
        self.action = np.full(shape, STOP, dtype=np.int64)
        self.delivered = np.zeros(shape, dtype=np.int64)
        self.energy = np.zeros(shape)
        self.closest = np.full(shape, np.inf)
        self.contacts: list[list[tuple[float, int, int, int, float]]] = [[] for _ in range(steps + 1)]

    def touch(
        self, steps: Iterable[int], kind: ContactKind, a: int, b: int, impulse: float = 0.01, period: int = 2
    ) -> None:
        """Let two bodies be in contact at the end of control period `period` of the decisions `steps`."""
        for step in steps:
            time = (step - 1) * PERIOD + 0.1 * (period + 1)
            self.contacts[step].append((time, int(kind), a, b, impulse))

    def meet(self, steps: Iterable[int], a: int, b: int, **how: Any) -> None:
        """Let two robots touch."""
        self.touch(steps, ContactKind.ROBOT_ROBOT, min(a, b), max(a, b), **how)

    def press(self, steps: Iterable[int], robot: int, pellet: int, **how: Any) -> None:
        """Let a robot touch a loose pellet."""
        self.touch(steps, ContactKind.ROBOT_PELLET, robot, pellet, **how)

    def rub(self, steps: Iterable[int], robot: int, **how: Any) -> None:
        """Let a robot touch a wall."""
        self.touch(steps, ContactKind.ROBOT_WALL, robot, -1, **how)

    def drive(self, robot: int, path: Sequence[tuple[int, float, float]], action: int = 3) -> None:
        """Move a robot straight between (decision, x, y), and let it decide to; it faces where it goes."""
        steps = np.array([stop[0] for stop in path])
        now = np.arange(steps[0], steps[-1] + 1)
        for axis in (0, 1):
            self.pose[now, robot, axis] = np.interp(now, steps, [stop[1 + axis] for stop in path])
        self.pose[steps[-1] :, robot, :2] = path[-1][1:]
        self.action[steps[0] + 1 : steps[-1] + 1, robot] = action
        for (begin, *here), (end, *there) in pairwise(path):
            if here != there:
                self.pose[begin:end, robot, 2] = np.arctan2(there[1] - here[1], there[0] - here[0])

    def frames(self) -> list[Frame]:
        """The run as frames."""
        pellets = self.arena.pellets.count
        return [
            Frame(
                step=step,
                time=step * PERIOD,
                pose=self.pose[step],
                mode=self.mode[step],
                laden=self.laden[step],
                action=self.action[step],
                reward=np.zeros(self.robots, dtype=np.float32),
                pellets=np.zeros((pellets, 2)),
                pellet_status=np.zeros(pellets, dtype=np.uint8),
                delivered=self.delivered[step],
                energy=self.energy[step],
                closest=self.closest[step],
                density=0.0,
                pheromone=np.zeros((self.arena.rows, self.arena.columns)),
                contacts=_contacts(self.contacts[step]),
            )
            for step in range(self.steps + 1)
        ]

    def watch(self, size: int | None = None) -> Episode:
        """What a monitor makes of it; with `size`, of chunks of so many rows."""
        return watch(self.arena, self.robots, self.frames(), size)


def _contacts(rows: list[tuple[float, int, int, int, float]]) -> Contacts:
    rows = sorted(rows)
    count = len(rows)
    return Contacts(
        env=np.zeros(count, dtype=np.int64),
        time=np.array([row[0] for row in rows]),
        kind=np.array([row[1] for row in rows], dtype=np.uint8),
        a=np.array([row[2] for row in rows], dtype=np.int64),
        b=np.array([row[3] for row in rows], dtype=np.int64),
        position=np.zeros((count, 2)),
        impulse=np.array([row[4] for row in rows]),
    )


def columns_for(arena: Arena, robots: int, size: int) -> FrameColumns:
    """Empty columns for frames of an arena."""
    return FrameColumns(robots, arena.pellets.count, (arena.rows, arena.columns), size)


def watch(arena: Arena, robots: int, frames: Iterable[Frame], size: int | None = None) -> Episode:
    """Watch frames one by one, or handed over in chunks of `size` rows."""
    monitor = EpisodeMonitor(arena, robots)
    if size is None:
        for frame in frames:
            monitor.add(frame)
        return monitor.finish()
    columns = columns_for(arena, robots, size)
    for frame in frames:
        if columns.add(frame):
            monitor.look(columns)
            columns.clear()
    monitor.look(columns)
    return monitor.finish()


def differences(one: Any, other: Any, name: str = "episode") -> list[str]:
    """The names of all fields in which two results are not the same to the last bit."""
    if isinstance(one, Arena):
        return [] if one is other else [name]
    if is_dataclass(one) and not isinstance(one, type):
        parts = [(part.name, getattr(one, part.name), getattr(other, part.name)) for part in fields(one)]
        return [text for key, a, b in parts for text in differences(a, b, f"{name}.{key}")]
    if isinstance(one, np.ndarray):
        same = one.dtype == other.dtype and np.array_equal(one, other)
        return [] if same else [name]
    if isinstance(one, (list, tuple)):
        if len(one) != len(other):
            return [f"{name}: {len(one)} and {len(other)}"]
        pairs = enumerate(zip(one, other, strict=True))
        return [text for index, (a, b) in pairs for text in differences(a, b, f"{name}[{index}]")]
    return [] if one == other else [f"{name}: {one} and {other}"]


class Run:
    """Frames of one episode."""

    def __init__(self, arena: Arena, robots: int, frames: list[Frame]) -> None:
        self.arena, self.robots, self.frames = arena, robots, frames

    def __repr__(self) -> str:
        return f"{len(self.frames)} frames of {self.robots} robots in {self.arena.name}"

    def watch(self, size: int | None = None) -> Episode:
        return watch(self.arena, self.robots, self.frames, size)


class Reckless:
    """Everyone takes the shortest path, whoever comes, and a random one now and then: it clogs."""

    name = "reckless"

    def __init__(self) -> None:
        self._rng = np.random.default_rng(1)

    def reset(self, env: VectorEnv) -> None:
        arena = env.arena
        rows, columns = np.mgrid[0 : arena.rows, 0 : arena.columns]
        centres = (np.stack([columns, rows], axis=-1) + 0.5) * arena.cell_size
        distance = arena.distances.sample(centres)
        distance[arena.zones == 0] = np.inf
        self._best = np.stack(
            [np.roll(distance, shift, axis) for axis, shift in ((0, -1), (0, 1), (1, 1), (1, -1))]
        ).argmin(axis=0)

    def act(self, env: VectorEnv, observation: Any) -> Any:
        pose, laden = env.world.state.pose, env.world.state.held >= 0
        cell = (pose[..., :2] / env.arena.cell_size).astype(int)
        action = self._best[cell[..., 1], cell[..., 0], np.where(laden, 0, 1)]
        careless = self._rng.random(action.shape) < 0.15
        return np.where(careless, self._rng.integers(0, 5, action.shape), action)


REAL: dict[str, tuple[str, str, int, int]] = {
    "lanes on three-wide": ("three-wide", "lanes", 6, 500),
    "random on single-lane": ("single-lane", "random", 6, 400),
    "reckless on single-lane": ("single-lane", "reckless", 6, 600),
    "reckless on two-tunnels": ("two-tunnels", "reckless", 8, 500),
    "reckless on three-wide": ("three-wide", "reckless", 8, 600),
    "lanes on two-tunnels": ("two-tunnels", "lanes", 5, 400),
}
"""Arena, controller, robots, decisions."""


@cache
def real(name: str) -> Run:
    """Frames of a real run, copied as they came."""
    arena, controller, robots, steps = REAL[name]
    env = VectorEnv(arena, robots=robots, episode_steps=steps, autoreset=False)
    driver = Reckless() if controller == "reckless" else make_controller(controller)
    observation = env.reset(seed=4)
    driver.reset(env)
    env.world.meter()
    frames = [_copy(env.frame())]
    for _ in range(steps):
        observation = env.step(driver.act(env, observation)).observation
        frames.append(_copy(env.frame()))
    return Run(env.arena, robots, frames)


def _copy(frame: Frame) -> Frame:
    arrays = {
        one.name: getattr(frame, one.name).copy()
        for one in fields(frame)
        if isinstance(getattr(frame, one.name), np.ndarray)
    }
    return replace(frame, **arrays)


@cache
def small() -> Arena:
    """The small arena with two tunnels."""
    return parse_arena(SMALL, "small.toml")


@cache
def without_tunnel() -> Arena:
    """The same with a floor for a tunnel."""
    return parse_arena(OPEN, "open.toml")


@st.composite
def runs(draw: st.DrawFn, least: int = 0, most: int = 90) -> Run:
    """Frames of no physics: robots jump and rest, touch and let go, at every rate from never to always."""
    arena = draw(st.sampled_from([small(), small(), small(), without_tunnel()]))
    robots = draw(st.integers(1, 5))
    script = Script(arena, robots, draw(st.integers(least, most)))
    rates = st.sampled_from([0.0, 0.02, 0.1, 0.5, 1.0])
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))

    def sometimes(rate: float) -> np.ndarray:
        return rng.random((script.steps + 1, robots)) < rate

    rows, columns = np.nonzero(arena.zones != 0)
    cell = rng.integers(0, len(rows), (script.steps + 1, robots))
    jumps, creeps = sometimes(draw(rates) * 0.2), sometimes(draw(rates))
    place = np.stack([columns[cell], rows[cell]], axis=-1) + rng.uniform(0.05, 0.95, (*cell.shape, 2))
    creep = rng.normal(0.0, 0.02, (*cell.shape, 2))
    script.pose[0, :, :2] = place[0] * arena.cell_size
    for step in range(1, script.steps + 1):
        crept = script.pose[step - 1, :, :2] + creeps[step, :, None] * creep[step]
        script.pose[step, :, :2] = np.where(
            jumps[step, :, None], place[step] * arena.cell_size, np.clip(crept, 0.011, (1.339, 0.739))
        )
    script.pose[..., 2] = rng.uniform(-np.pi, np.pi, cell.shape)
    script.action = np.where(sometimes(draw(rates)), STOP, rng.integers(0, 4, cell.shape))
    script.mode = rng.integers(0, len(Mode), cell.shape).astype(np.uint8)
    script.laden = np.logical_xor.accumulate(sometimes(draw(rates) * 0.3), axis=0)
    script.delivered = np.cumsum(sometimes(draw(rates) * 0.3) * rng.integers(1, 3, cell.shape), axis=0)
    script.delivered -= script.delivered[0]
    script.energy = np.cumsum(rng.exponential(0.01, cell.shape), axis=0)
    touching = draw(rates)
    for step in range(1, script.steps + 1):
        for a in range(robots):
            for kind, other in (
                *((ContactKind.ROBOT_ROBOT, b) for b in range(a + 1, robots)),
                *((ContactKind.ROBOT_PELLET, pellet) for pellet in range(arena.pellets.count)),
                (ContactKind.ROBOT_WALL, -1),
            ):
                for period in range(3):
                    if rng.random() < touching * 0.3:
                        script.touch([step], kind, a, other, rng.exponential(0.02), period)
    return Run(arena, robots, script.frames())


@st.composite
def crowds(draw: st.DrawFn) -> Run:
    """Robots that mostly stand about a tunnel and touch for a while: groups grow, part, pause and merge."""
    arena, robots = small(), draw(st.integers(2, 6))
    script = Script(arena, robots, 120)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    shape = (script.steps + 1, robots)
    jumps = rng.random(shape) < draw(st.sampled_from([0.005, 0.02, 0.05]))
    jumps[0] = True
    # About the upper tunnel, cells (3, 3) and (3, 4), and now and then in the lower one.
    cells = np.array([(2, 3), (3, 3), (4, 3), (5, 3), (3, 3), (4, 3), (4, 1), (1, 3)])
    places = (cells[rng.integers(0, len(cells), shape)] + rng.uniform(0.05, 0.95, (*shape, 2))) * ROOM
    last = np.maximum.accumulate(np.where(jumps, np.arange(len(jumps))[:, None], 0), axis=0)
    script.pose[..., :2] = np.take_along_axis(places, last[..., None], axis=0)
    script.pose[..., 2] = rng.uniform(-np.pi, np.pi, shape)
    script.action = np.where(rng.random(shape) < draw(st.sampled_from([0.0, 0.3, 0.5])), STOP, 3)
    script.laden = np.logical_xor.accumulate(rng.random(shape) < 0.02, axis=0)
    begins, ends = draw(st.sampled_from([0.002, 0.01, 0.05])), draw(st.sampled_from([0.05, 0.2, 1.0]))
    others = [(a, ContactKind.ROBOT_ROBOT, b) for a in range(robots) for b in range(a + 1, robots)]
    others += [(a, ContactKind.ROBOT_PELLET, b) for a in range(robots) for b in range(2)]
    others += [(a, ContactKind.ROBOT_WALL, -1) for a in range(robots)]
    for a, kind, b in others:
        touching = False
        for step, chance in enumerate(rng.random(script.steps + 1)):
            touching = chance >= ends if touching else chance < begins
            if touching:
                script.touch([step], kind, a, b)
    return Run(arena, robots, script.frames())
