"""The arena, its robots and its pellets as a MuJoCo model (MJCF), from nothing but the data sheets.

A robot is a chassis on two wheels with motors and two casters, and a gripper that lifts what it holds. What
the data sheet leaves open, since two dimensions do not ask for it, is chosen here and named.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, SubElement, tostring

from robosim.arena.model import Arena
from robosim.robot.sheet import GRAVITY, RobotSheet
from robosim.world.draws import Draws

LONGEST_STEP = 0.0028
"""Of the solver, s: contacts are springs of a few milliseconds, which a step must resolve."""
CONTACT_TIME = 0.008
"""Time constant of contacts, s; MuJoCo wants at least two steps."""
CONTACT_IMPEDANCE = "0.95 0.99 0.0005"
"""Stiffer than MuJoCo's own 0.9 0.95 0.001, so that walls give way by less than 0.1 mm to a robot's push."""
FRICTION_IMPEDANCE = 10.0
"""How much stiffer friction is than the normal direction; at 1 a robot that pushes creeps."""
SLEEP_SPEED = 1e-3
"""Speed under which pellets at rest fall asleep, m/s."""

WALL_FRICTION = 0.3
"""As in pymunk."""
WHEEL_MASS = 0.01
"""Of one wheel, as a share of the robot's."""
PAD_MASS = 0.005
"""Of what the gripper moves, as a share of the robot's."""
CASTER_GAP = 5e-4
"""Between the casters and the ground, m: the wheels carry a robot at rest, as its traction says."""
CASTER_PLACE = 0.8
"""Of the casters, ahead of and behind the axle, in half lengths."""
STALL_TORQUE = 1.0
"""Of a motor, in torques at which a wheel that carries half the robot slips: so a robot pushes with its
traction at most, as on the data sheet, and its wheels need not spin for it."""
MOTOR_LAG = 0.008
"""Time constant with which a motor brings its wheel to the commanded speed, s: a stiff speed controller."""
ROTOR = 0.5
"""Inertia of a motor as its wheel feels it through the gears, in that of half the robot at the wheel's rim.
Without any, friction under a wheel that weighs next to nothing would be worked out from a torque that is gone
when the step ends."""
PAD_SPEED = 0.02
"""Speed at which the gripper draws back a pellet that a knock has shifted, m/s; the same as in pymunk."""
PAD_GAIN = 20.0
"""Of the gripper's controller, 1/s."""
LIFT = 0.002
"""Height to which a gripper lifts a pellet, m."""
PELLET_HEIGHT = 1.0
"""Of a pellet, in radii."""

GROUND, SIDES = 1, 2
"""Bits of what collides: wheels, casters and the undersides of pellets with the ground; sides with sides."""
NUMBERS_OF_BODY = 7
"""Of the place of a free body in qpos, x y z and a quaternion."""


def solver_steps(arena: Arena) -> int:
    """Return how many steps of MuJoCo make a substep of the arena's timing."""
    return math.ceil(arena.timing.substep / LONGEST_STEP)


def pellet_centre(arena: Arena) -> float:
    """Height of a pellet's centre above the ground, m."""
    return 0.5 * PELLET_HEIGHT * arena.pellets.radius


def model_text(arena: Arena, draws: Draws) -> str:
    """Return the model of an episode as MJCF, which MuJoCo and its viewers load."""
    root = Element("mujoco", model=arena.name)
    SubElement(root, "compiler", angle="radian")
    option = SubElement(
        root,
        "option",
        timestep=repr(arena.timing.substep / solver_steps(arena)),
        gravity=f"0 0 {-GRAVITY}",
        integrator="implicitfast",
        cone="elliptic",
        impratio=repr(FRICTION_IMPEDANCE),
        sleep_tolerance=repr(SLEEP_SPEED),
    )
    SubElement(option, "flag", sleep="enable", multiccd="disable")
    default = SubElement(root, "default")
    SubElement(
        default,
        "geom",
        condim="3",
        contype="0",
        conaffinity="0",
        solref=f"{CONTACT_TIME} 1",
        solimp=CONTACT_IMPEDANCE,
    )
    world, actuators = SubElement(root, "worldbody"), SubElement(root, "actuator")
    _add_ground(world, arena)
    for robot, pose in enumerate(draws.robot_pose.tolist()):
        mass = arena.robot.mass * float(draws.robot_mass[robot])
        traction = arena.robot.traction * float(draws.traction[robot])
        _add_robot(world, arena, robot, pose, mass, traction)
        _add_motors(actuators, arena.robot, robot, mass, traction)
    for pellet, place in enumerate(draws.pellet_place.tolist()):
        mass = arena.pellets.mass * float(draws.pellet_mass[pellet])
        friction = arena.pellets.friction * float(draws.pellet_friction[pellet])
        _add_pellet(world, arena, pellet, place, mass, friction)
    if len(draws.pellet_place):
        equality = SubElement(root, "equality")
        for robot in range(len(draws.robot_pose)):
            # Which pellet it is, is written into the model when one is taken.
            SubElement(
                equality, "weld", name=f"grip{robot}", body1=f"pad{robot}", body2="pellet0", active="false"
            )
    return tostring(root, encoding="unicode")


def _add_ground(world: Element, arena: Arena) -> None:
    # Frictionless itself: MuJoCo takes the larger coefficient of two, so that of what rests on it counts.
    SubElement(
        world,
        "geom",
        name="ground",
        type="plane",
        size="0 0 1",
        contype=str(GROUND),
        condim="1",
        friction="0 0 0",
    )
    height = 2.0 * _body_height(arena)
    for index, (x0, y0, x1, y1) in enumerate(arena.walls.tolist()):
        SubElement(
            world,
            "geom",
            name=f"wall{index}",
            type="box",
            pos=_numbers(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0),
            size=_numbers(0.5 * (x1 - x0), 0.5 * (y1 - y0), height),
            contype=str(SIDES),
            friction=_friction(WALL_FRICTION),
        )


def _add_robot(
    world: Element, arena: Arena, robot: int, pose: list[float], mass: float, traction: float
) -> None:
    sheet = arena.robot
    axle = sheet.wheel_radius
    x, y, heading = pose
    body = SubElement(
        world,
        "body",
        name=f"robot{robot}",
        pos=_numbers(x, y, axle),
        euler=_numbers(0.0, 0.0, heading),
        sleep="never",
    )
    SubElement(body, "freejoint", name=f"robot{robot}")
    wheel_mass, pad_mass = WHEEL_MASS * mass, PAD_MASS * mass
    nose = 0.5 * sheet.length + arena.pellets.radius
    # All together have the mass of the data sheet, and the moment about the vertical of its outline.
    rest = moment_of(sheet, mass) - 2.0 * wheel_mass * (0.5 * sheet.wheel_base) ** 2 - pad_mass * nose**2
    tilting = 0.5 * rest + mass * _body_height(arena) ** 2 / 12.0
    SubElement(
        body,
        "inertial",
        pos="0 0 0",
        mass=repr(mass - 2.0 * wheel_mass - pad_mass),
        diaginertia=_numbers(tilting, tilting, rest),
    )
    _add_outline(body, arena, robot)
    for name, side in (("left", 1.0), ("right", -1.0)):
        wheel = SubElement(
            body, "body", name=f"{name}{robot}", pos=_numbers(0.0, side * 0.5 * sheet.wheel_base, 0.0)
        )
        SubElement(
            wheel,
            "joint",
            name=f"{name}{robot}",
            type="hinge",
            axis="0 1 0",
            armature=repr(ROTOR * felt_at_wheel(sheet, mass)),
        )
        # A ball touches the ground in one point, half the wheel base from the middle, as a thin wheel does.
        SubElement(
            wheel,
            "geom",
            type="sphere",
            size=repr(axle),
            mass=repr(wheel_mass),
            conaffinity=str(GROUND),
            friction=_friction(traction),
        )
    caster = 0.25 * axle
    for end in (1.0, -1.0):
        SubElement(
            body,
            "geom",
            type="sphere",
            size=repr(caster),
            mass="0",
            pos=_numbers(end * CASTER_PLACE * 0.5 * sheet.length, 0.0, caster + CASTER_GAP - axle),
            conaffinity=str(GROUND),
            condim="1",
            friction="0 0 0",
        )
    pad = SubElement(body, "body", name=f"pad{robot}", pos=_numbers(nose, 0.0, pellet_centre(arena) - axle))
    SubElement(
        pad, "inertial", pos="0 0 0", mass=repr(pad_mass), diaginertia=_numbers(*[1e-4 * pad_mass] * 3)
    )
    for axis, direction in (("x", "1 0 0"), ("y", "0 1 0")):
        SubElement(pad, "joint", name=f"pad{axis}{robot}", type="slide", axis=direction)


def _add_outline(body: Element, arena: Arena, robot: int) -> None:
    """Add the body's side, level with the pellets and round, so that it touches things level, in a point."""
    sheet = arena.robot
    level = pellet_centre(arena) - sheet.wheel_radius
    half, side = 0.5 * sheet.length, 0.5 * sheet.width
    shape = {
        "circle": {"type": "sphere", "size": repr(side), "pos": _numbers(0.0, 0.0, level)},
        "capsule": {
            "type": "capsule",
            "size": repr(side),
            "fromto": _numbers(side - half, 0.0, level, half - side, 0.0, level),
        },
        "box": {"type": "box", "size": _numbers(half, side, 2.0 * LIFT), "pos": _numbers(0.0, 0.0, level)},
    }[sheet.shape]
    SubElement(
        body,
        "geom",
        shape,
        name=f"side{robot}",
        mass="0",
        contype=str(SIDES),
        conaffinity=str(SIDES),
        friction=_friction(sheet.friction),
    )


def _add_motors(actuators: Element, sheet: RobotSheet, robot: int, mass: float, traction: float) -> None:
    radius = sheet.wheel_radius
    torque = STALL_TORQUE * 0.5 * traction * mass * GRAVITY * radius
    for name in ("left", "right"):
        SubElement(
            actuators,
            "velocity",
            name=f"{name}{robot}",
            joint=f"{name}{robot}",
            kv=repr((1.0 + ROTOR) * felt_at_wheel(sheet, mass) / MOTOR_LAG),
            forcerange=_numbers(-torque, torque),
        )
    force = sheet.grip_force
    for axis in ("x", "y"):
        SubElement(
            actuators,
            "velocity",
            name=f"pad{axis}{robot}",
            joint=f"pad{axis}{robot}",
            kv=repr(force / PAD_SPEED),
            forcerange=_numbers(-force, force),
        )


def _add_pellet(
    world: Element, arena: Arena, pellet: int, place: list[float], mass: float, friction: float
) -> None:
    radius, half = arena.pellets.radius, pellet_centre(arena)
    body = SubElement(world, "body", name=f"pellet{pellet}", pos=_numbers(*place, half), sleep="allowed")
    SubElement(body, "freejoint", name=f"pellet{pellet}")
    SubElement(
        body,
        "geom",
        type="cylinder",
        size=_numbers(radius, half),
        mass=repr(mass),
        conaffinity=str(GROUND),
        friction=_friction(friction),
    )
    # Its side is that of a ball, which touches everything level, in one point, and is quick to collide.
    SubElement(
        body,
        "geom",
        name=f"rim{pellet}",
        type="sphere",
        size=repr(radius),
        mass="0",
        contype=str(SIDES),
        conaffinity=str(SIDES),
        friction=_friction(arena.pellets.friction),
    )


def moment_of(sheet: RobotSheet, mass: float) -> float:
    """Moment of inertia about the vertical, kg m^2: that of an even plate, as in pymunk."""
    if sheet.shape == "circle":
        return 0.5 * mass * (0.5 * sheet.length) ** 2
    return mass * (sheet.length**2 + sheet.width**2) / 12.0


def felt_at_wheel(sheet: RobotSheet, mass: float) -> float:
    """Inertia that a wheel feels of its robot on a straight line, kg m^2: half of its mass at the rim."""
    return 0.5 * mass * sheet.wheel_radius**2


def _body_height(arena: Arena) -> float:
    """Height of a robot, m: over that of a lifted pellet."""
    return max(0.5 * arena.robot.width, 2.0 * (pellet_centre(arena) + LIFT))


def _friction(sliding: float) -> str:
    return _numbers(sliding, 0.0, 0.0)


def _numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
