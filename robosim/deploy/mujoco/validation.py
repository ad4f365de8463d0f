"""Experiments whose outcome follows from the data sheet, in either engine.

Each puts robots of the default data sheet, or a pellet, on a wide floor, and measures by the state of the
world alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.arena import parse_arena
from robosim.arena.model import PelletSheet
from robosim.deploy.mujoco.world import MujocoWorld
from robosim.robot.drivers import STOP, Wheels
from robosim.robot.sheet import GRAVITY, RobotSheet
from robosim.world.physics.world import PhysicsWorld
from robosim.world.state import Gripper

Floats = NDArray[np.float64]
Pose = tuple[float, float, float]

ENGINES: dict[str, type[PhysicsWorld]] = {"pymunk": PhysicsWorld, "mujoco": MujocoWorld}
FLOOR = "\n".join(["#" * 22, "#HH" + "." * 16 + "SS#", *["#" + "." * 20 + "#"] * 9, "#" * 22])
"""4 x 2 m inside the border, in cells of 0.2 m; home and source in the upper corners."""
EAST_WALL = 4.2
"""m."""
MIDDLE = (2.2, 1.1)
SHEET = RobotSheet()
TOP = SHEET.max_wheel_speed
ACCELERATION = SHEET.max_wheel_acceleration * SHEET.wheel_radius
"""m/s^2."""
PELLET = PelletSheet()
SLIDING = 0.5
"""m/s."""
FORWARD = int(Wheels.FORWARD)
KEEP = np.full((1, 1), Gripper.KEEP, dtype=np.int8)


@dataclass(frozen=True, slots=True)
class Experiment:
    """A quantity that the data sheet determines, and how it is measured."""

    name: str
    unit: str
    expected: float
    """By the closed form."""
    form: str
    """The closed form."""
    measure: Callable[[type[PhysicsWorld]], float]
    tolerance: float
    """Share by which MuJoCo may be off; what is expected to be 0 may be off by this in its unit."""


def begun(engine: type[PhysicsWorld], *poses: Pose) -> PhysicsWorld:
    """Return a world with robots at these poses and one pellet, which lies far away."""
    starts = [list(map(float, pose)) for pose in poses]
    text = f'name = "floor"\ncell_size = 0.2\nmap = """\n{FLOOR}\n"""\n'
    arena = parse_arena(f"{text}[pellets]\ncount = 1\n[start]\nposes = {starts}", "floor")
    world = engine(arena, len(poses), 1, "wheels")
    world.reset([np.random.SeedSequence(0)])
    return world


def driven(world: PhysicsWorld, left: float, right: float, periods: int) -> Iterator[Floats]:
    """Hold wheel speeds (rad/s) in all robots; yield the poses [robots, 3] after each control period."""
    for _ in range(periods):
        world.drive(np.broadcast_to([left, right], (1, world.robots, 2)).astype(float))
        yield world.state.pose[0].copy()


def last(poses: Iterator[Floats]) -> Floats:
    """Return the first robot's pose [3] after the last control period."""
    *_, end = poses
    first: Floats = end[0]
    return first


def straight_speed(engine: type[PhysicsWorld]) -> float:
    """Speed of a robot under way, m/s."""
    world = begun(engine, (*MIDDLE, 0.0))
    begin = last(driven(world, TOP, TOP, 3))
    end = last(driven(world, TOP, TOP, 5))
    return float(np.hypot(*(end - begin)[:2]) / 0.5)


def astray(engine: type[PhysicsWorld]) -> float:
    """How far a robot leaves its line over 0.4 m, mm."""
    world = begun(engine, (*MIDDLE, 0.0))
    return float(1e3 * abs(last(driven(world, TOP, TOP, 20))[1] - MIDDLE[1]))


def started_distance(engine: type[PhysicsWorld]) -> float:
    """How far a robot comes in 0.3 s from rest, m."""
    return float(last(driven(begun(engine, (*MIDDLE, 0.0)), TOP, TOP, 3))[0] - MIDDLE[0])


def stopping_distance(engine: type[PhysicsWorld]) -> float:
    """How far a robot goes on from its top speed once it is to stand, m."""
    world = begun(engine, (*MIDDLE, 0.0))
    begin = last(driven(world, TOP, TOP, 5))
    return float(last(driven(world, 0.0, 0.0, 5))[0] - begin[0])


def turning_rate(engine: type[PhysicsWorld]) -> float:
    """Of a robot on the spot, rad/s."""
    world = begun(engine, (*MIDDLE, 0.0))
    headings = np.array([pose[0, 2] for pose in driven(world, -TOP, TOP, 23)])[2:]
    return float((np.unwrap(headings)[-1] - headings[0]) / 2.0)


def turn_wander(engine: type[PhysicsWorld]) -> float:
    """How far the middle of a robot comes while it turns on the spot for 2 s, mm."""
    world = begun(engine, (*MIDDLE, 0.0))
    places = np.array([pose[0, :2] for pose in driven(world, -TOP, TOP, 20)])
    return float(1e3 * np.hypot(*(places - MIDDLE).T).max())


def arc_radius(engine: type[PhysicsWorld]) -> float:
    """Of the circle that a robot drives with one wheel at top speed and one at half of it, m."""
    world = begun(engine, (*MIDDLE, 0.0))
    x, y, _ = np.array([pose[0] for pose in driven(world, 0.5 * TOP, TOP, 38)])[3:].T
    # The circle through all places, by least squares (Kasa 1976).
    fit = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=1), x * x + y * y, rcond=None)[0]
    return float(math.sqrt(fit[2] + (fit[0] ** 2 + fit[1] ** 2) / 4.0))


def press(world: PhysicsWorld, substeps: int) -> float:
    """Return the force (N) of all contacts, the mean over so many substeps with the wheels as they are."""
    bodies, total = world.spaces[0], 0.0
    for _ in range(substeps):
        bodies.forget_contacts()
        bodies.drive_substep()
        bodies.list_contacts()
        total += float(np.hypot(*bodies.contacts()[1][:, :2].T).sum())
    return total / substeps / world.arena.timing.substep


def at_wall(engine: type[PhysicsWorld]) -> PhysicsWorld:
    """Return a world in which a robot has driven against a wall for 3 s."""
    world = begun(engine, (EAST_WALL - 0.5 * SHEET.length - 0.03, 1.1, 0.0))
    last(driven(world, TOP, TOP, 30))
    return world


def wall_force(engine: type[PhysicsWorld]) -> float:
    """Force of a robot that drives against a wall, N: the mean over 1 s."""
    return press(at_wall(engine), 120)


def wall_overlap(engine: type[PhysicsWorld]) -> float:
    """How far a robot has driven into a wall after 3 s, mm."""
    return float(1e3 * (at_wall(engine).state.pose[0, 0, 0] + 0.5 * SHEET.length - EAST_WALL))


def sliding_distance(engine: type[PhysicsWorld]) -> float:
    """How far a pellet slides from 0.5 m/s, m."""
    world = begun(engine, (0.8, 0.5, 0.0))
    world.spaces[0].place(0, np.array(MIDDLE), (SLIDING, 0.0))
    for _ in range(4):
        world.step(np.array([[STOP]]), KEEP)
    return float(world.state.pellets[0, 0, 0] - MIDDLE[0])


def pushing_force(engine: type[PhysicsWorld]) -> float:
    """With which a robot pushes a pellet ahead of it at top speed, N: the mean over 3 s."""
    world = begun(engine, (1.0, 1.1, 0.0))
    world.spaces[0].place(0, np.array([1.0 + 0.5 * SHEET.length + 0.021, 1.1]))
    last(driven(world, TOP, TOP, 5))
    return press(world, 360)


def gripping_force(engine: type[PhysicsWorld]) -> float:
    """With which a robot presses the pellet that it holds against a wall, N: the median until it is torn."""
    reach = 0.5 * SHEET.length + 0.055
    world = begun(engine, (EAST_WALL - reach - 0.021, 1.1, 0.0))
    world.spaces[0].place(0, np.array([EAST_WALL - 0.021, 1.1]))
    world.step(np.array([[STOP]]), KEEP)
    world.step(np.array([[STOP]]), np.full((1, 1), Gripper.TAKE, dtype=np.int8))
    slow, forces = np.full((1, 1, 2), 0.25 * TOP), []
    while world.state.held[0, 0] >= 0:
        world.begin_decision()
        for _ in range(world.arena.timing.control_steps - 1):
            world.drive(slow)
        world.end_decision(slow, KEEP)
        forces += (world.contacts.impulse / world.arena.timing.substep).tolist()
    return float(np.median(forces))


EXPERIMENTS = (
    Experiment("speed, straight on", "m/s", SHEET.top_speed, "r w", straight_speed, 0.01),
    Experiment("off the line after 0.4 m", "mm", 0.0, "0", astray, 0.5),
    Experiment(
        "distance in the first 0.3 s", "m", SHEET.top_speed * 0.3 - 0.5 * SHEET.top_speed**2 / ACCELERATION,
        "v t - v^2 / (2 a)", started_distance, 0.03,
    ),
    Experiment(
        "distance to a stop from top speed", "m", 0.5 * SHEET.top_speed**2 / ACCELERATION, "v^2 / (2 a)",
        stopping_distance, 0.1,
    ),
    Experiment("turning rate on the spot", "rad/s", SHEET.top_turn_rate, "2 v / base", turning_rate, 0.01),
    Experiment("wander of a turn on the spot", "mm", 0.0, "0", turn_wander, 0.5),
    Experiment(
        "radius of an arc, one wheel at half speed", "m", 1.5 * SHEET.wheel_base,
        "base (w + w/2) / (2 (w - w/2))", arc_radius, 0.01,
    ),
    Experiment("force against a wall", "N", SHEET.traction_force, "mu m g", wall_force, 0.05),
    Experiment("depth in the wall", "mm", 0.0, "0", wall_overlap, 0.2),
    Experiment(
        "distance of a pellet from 0.5 m/s", "m", SLIDING**2 / (2.0 * PELLET.friction * GRAVITY),
        "v^2 / (2 mu g)", sliding_distance, 0.05,
    ),
    Experiment(
        "force that pushes a pellet", "N", PELLET.friction * PELLET.mass * GRAVITY, "mu m g",
        pushing_force, 0.1,
    ),
    Experiment("force at which a grip gives", "N", SHEET.grip_force, "data sheet", gripping_force, 0.05),
)  # fmt: skip
