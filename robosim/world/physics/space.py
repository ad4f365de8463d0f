"""One environment's bodies in a pymunk Space, built anew for every episode.

Bodies are added in a fixed order (walls, robots, pellets), because the solver's result depends on
it; a Space that is reset in place does not repeat itself.
"""

from __future__ import annotations

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk import batch

from robosim.arena.model import Arena
from robosim.robot.sheet import GRAVITY, RobotSheet
from robosim.robot.team import Team
from robosim.world.draws import Draws
from robosim.world.physics.buffers import borrow_buffers

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SOLVER_ITERATIONS = 10
CONTACT_SLOP = 2e-4
"""Overlap that the solver leaves between touching bodies, m."""
OVERLAP_LEFT = 0.7**60
"""Share of an overlap that is left after a second: three tenths of it go in a sixtieth."""
SLEEP_AFTER = 0.3
"""Time at rest after which a pellet falls asleep and costs nothing, s."""
REST_SPEED = 2e-3
"""Speed under which a pellet counts as at rest, m/s."""
WALL_FRICTION = 0.3
BOX_ROUNDING = 0.1
"""Radius of a box robot's corners, as a share of its width."""
GRIP_RECOVERY = 0.02
"""Speed at which a gripper draws back a pellet that a knock has shifted, m/s; slow, or knocks shorter than a
decision would leave no trace."""
BOND_SLACK = 0.05
"""Gap over which cohesion begins to pull two pellets together, in pellet radii."""

BODY_FIELDS = (
    batch.BodyFields.BODY_ID
    | batch.BodyFields.POSITION
    | batch.BodyFields.ANGLE
    | batch.BodyFields.VELOCITY
    | batch.BodyFields.ANGULAR_VELOCITY
)
BODY_FLOATS = 6
POSE_FIELDS = batch.BodyFields.POSITION | batch.BodyFields.ANGLE
ARBITER_FIELDS = (
    batch.ArbiterFields.BODY_A_ID
    | batch.ArbiterFields.BODY_B_ID
    | batch.ArbiterFields.TOTAL_IMPULSE
    | batch.ArbiterFields.POINT_A_1
)
ARBITER_FLOATS = 4
ARBITER_INT_BYTES = 2 * np.dtype(np.uintp).itemsize
COMMAND_FIELDS = batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY


class EpisodeSpace:
    """The Space of one environment during one episode, and the handles to what is in it.

    Each robot hangs on a kinematic control body by two joints whose velocity is the wheels' and
    whose largest force is the traction: so the solver drives, stalls and drags robots by itself.
    The control bodies live in a Space of their own that is never stepped, which makes commanding
    all robots a single call.
    """

    def __init__(self, arena: Arena, team: Team, draws: Draws, commands: Floats) -> None:
        """Build the bodies; `commands` [robots, 3] is read by every `drive` (m/s, m/s, rad/s)."""
        self._arena = arena
        self._sheets = team.sheets
        self._space = pymunk.Space(threaded=False)
        self._space.iterations = SOLVER_ITERATIONS
        self._space.collision_slop = CONTACT_SLOP
        self._space.collision_bias = OVERLAP_LEFT
        self._space.sleep_time_threshold = SLEEP_AFTER
        self._space.idle_speed_threshold = REST_SPEED
        # Contacts stay listed through a whole control period, so that one look at its end sees them all.
        self._space.collision_persistence = arena.timing.substeps
        self._substep = arena.timing.substep
        self._substeps = arena.timing.substeps
        self._controls = pymunk.Space()
        self._robots: list[pymunk.Body] = []
        self._pellets: list[pymunk.Body] = []
        self._ground: list[tuple[pymunk.PivotJoint, pymunk.GearJoint, float, float]] = []
        self._grips: dict[int, pymunk.PivotJoint] = {}
        self._bonds: dict[tuple[int, int], pymunk.SlideJoint] = {}
        self._absent: set[int] = set()
        self._add_walls()
        controls = [pymunk.Body(body_type=pymunk.Body.KINEMATIC) for _ in draws.robot_pose]
        self._controls.add(*controls)
        for robot, pose in enumerate(draws.robot_pose):
            factors = float(draws.robot_mass[robot]), float(draws.traction[robot])
            self._add_robot(team.sheets[robot], controls[robot], pose, *factors)
        for pellet, place in enumerate(draws.pellet_place):
            self._add_pellet(place, float(draws.pellet_mass[pellet]), float(draws.pellet_friction[pellet]))
        self.body_ids = np.array([body.id for body in (*self._robots, *self._pellets)], dtype=np.uintp)
        """[robots + pellets] pymunk's ids, robots first."""
        self.ground_id = np.uintp(self._space.static_body.id)
        """pymunk's id of the static body, which is listed among the others."""
        self._bodies, self._arbiters, self._commands = borrow_buffers(self, commands)

    def _add_walls(self) -> None:
        ground = self._space.static_body
        for x0, y0, x1, y1 in self._arena.walls.tolist():
            wall = pymunk.Poly(ground, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
            wall.friction = WALL_FRICTION
            self._space.add(wall)

    def _add_robot(
        self,
        sheet: RobotSheet,
        control: pymunk.Body,
        pose: Floats,
        mass_factor: float,
        traction_factor: float,
    ) -> None:
        mass = sheet.mass * mass_factor
        body = pymunk.Body(mass, _moment(sheet, mass))
        body.position = (float(pose[0]), float(pose[1]))
        body.angle = float(pose[2])
        shape = _outline(sheet, body)
        shape.friction = sheet.friction
        force = sheet.traction * traction_factor * mass * GRAVITY
        drive = pymunk.PivotJoint(control, body, (0.0, 0.0), (0.0, 0.0))
        drive.max_bias = 0.0
        drive.max_force = force
        turn = pymunk.GearJoint(control, body, 0.0, 1.0)
        turn.max_bias = 0.0
        turn.max_force = force * 0.5 * sheet.wheel_base
        self._space.add(body, shape, drive, turn)
        self._robots.append(body)

    def _add_pellet(self, place: Floats, mass_factor: float, friction_factor: float) -> None:
        sheet = self._arena.pellets
        mass = sheet.mass * mass_factor
        body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0.0, sheet.radius))
        body.position = (float(place[0]), float(place[1]))
        shape = pymunk.Circle(body, sheet.radius)
        shape.friction = sheet.friction
        # Joints to the ground that carry no position, only a limited force, are Coulomb friction.
        force = sheet.friction * friction_factor * mass * GRAVITY
        torque = 2.0 / 3.0 * sheet.radius * force
        ground = self._space.static_body
        slide = pymunk.PivotJoint(ground, body, (0.0, 0.0), (0.0, 0.0))
        slide.max_bias = 0.0
        slide.max_force = force
        spin = pymunk.GearJoint(ground, body, 0.0, 1.0)
        spin.max_bias = 0.0
        spin.max_force = torque
        self._space.add(body, shape, slide, spin)
        self._pellets.append(body)
        self._ground.append((slide, spin, force, torque))

    def drive(self) -> None:
        """Hold the velocities in `commands` for one control period."""
        batch.set_space_bodies(self._controls, COMMAND_FIELDS, self._commands)
        self.advance()

    def drive_substep(self) -> None:
        """Hold the velocities in `commands` for one substep."""
        batch.set_space_bodies(self._controls, COMMAND_FIELDS, self._commands)
        self._space.step(self._substep)

    def advance(self) -> None:
        """Run the solver for one control period: the floor under everything's cost."""
        step, substep = self._space.step, self._substep
        for _ in range(self._substeps):
            step(substep)

    def poses(self) -> Floats:
        """Return x, y, angle of all bodies, [n, 3], robots first.

        Robots come first and in order: they are added first, never sleep and are never removed.
        """
        self._bodies.clear()
        batch.get_space_bodies(self._space, POSE_FIELDS, self._bodies)
        return np.frombuffer(self._bodies.float_buf()).reshape(-1, 3)

    def bodies(self) -> tuple[NDArray[np.uintp], Floats]:
        """Return ids [n] and x, y, angle, vx, vy, rate [n, 6] of all bodies, robots first."""
        self._bodies.clear()
        batch.get_space_bodies(self._space, BODY_FIELDS, self._bodies)
        ids = np.frombuffer(self._bodies.int_buf(), dtype=np.uintp)
        return ids, np.frombuffer(self._bodies.float_buf()).reshape(-1, BODY_FLOATS)

    def forget_contacts(self) -> None:
        """Begin a new list of contacts."""
        self._arbiters.clear()

    def list_contacts(self) -> int:
        """Append the last control period's contacts to the list; returns its length."""
        batch.get_space_arbiters(self._space, ARBITER_FIELDS, self._arbiters)
        return len(self._arbiters.int_buf()) // ARBITER_INT_BYTES

    def contacts(self) -> tuple[NDArray[np.uintp], Floats]:
        """Return the list: body ids [n, 2], and impulse x, y, point x, y [n, 4]."""
        ids = np.frombuffer(self._arbiters.int_buf(), dtype=np.uintp).reshape(-1, 2)
        return ids, np.frombuffer(self._arbiters.float_buf()).reshape(-1, ARBITER_FLOATS)

    def grip(self, robot: int, pellet: int) -> tuple[float, float]:
        """Join a pellet to a robot and lift it off the ground; returns its place in the robot's frame, m."""
        joint = pymunk.PivotJoint(self._robots[robot], self._pellets[pellet], self._pellets[pellet].position)
        joint.max_force = self._sheets[robot].grip_force
        joint.max_bias = GRIP_RECOVERY
        self._space.add(joint)
        self._grips[pellet] = joint
        slide, spin, _, _ = self._ground[pellet]
        slide.max_force = 0.0
        spin.max_force = 0.0
        x, y = joint.anchor_a
        return x, y

    def release(self, pellet: int) -> None:
        """Let a held pellet drop to the ground where it is."""
        self._space.remove(self._grips.pop(pellet))
        slide, spin, force, torque = self._ground[pellet]
        slide.max_force = force
        spin.max_force = torque

    def place(self, pellet: int, place: Floats, velocity: tuple[float, float] = (0.0, 0.0)) -> None:
        """Put a pellet to a place, at rest or moving (m/s); an absent one comes back."""
        body = self._pellets[pellet]
        if pellet in self._absent:
            self._absent.remove(pellet)
            slide, spin, _, _ = self._ground[pellet]
            self._space.add(body, *body.shapes, slide, spin)
        else:
            self._unbond(pellet)
        body.position = (float(place[0]), float(place[1]))
        body.velocity = velocity
        body.angular_velocity = 0.0

    def take_out(self, pellet: int) -> None:
        """Remove a loose pellet until `place` brings it back."""
        self._unbond(pellet)
        body = self._pellets[pellet]
        slide, spin, _, _ = self._ground[pellet]
        self._space.remove(slide, spin, *body.shapes, body)
        self._absent.add(pellet)

    def cohere(self, touching: Integers, positions: Floats) -> None:
        """Bond the touching pellets, and break the bonds that are stretched beyond their reach.

        `touching` is [n, 2] pellet pairs with the lower first, `positions` [pellets, 2] in m.
        """
        radius = self._arena.pellets.radius
        if self._bonds:
            pairs = np.array(list(self._bonds), dtype=np.int64)
            apart = positions[pairs[:, 0]] - positions[pairs[:, 1]]
            stretched = np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2) > 2.5 * radius
            for first, second in pairs[stretched].tolist():
                self._space.remove(self._bonds.pop((first, second)))
        for first, second in touching.tolist():
            if (first, second) not in self._bonds:
                joint = pymunk.SlideJoint(
                    self._pellets[first],
                    self._pellets[second],
                    (0.0, 0.0),
                    (0.0, 0.0),
                    0.0,
                    (2.0 + BOND_SLACK) * radius,
                )
                joint.max_force = self._arena.pellets.cohesion
                self._space.add(joint)
                self._bonds[first, second] = joint

    def _unbond(self, pellet: int) -> None:
        for pair in [pair for pair in self._bonds if pellet in pair]:
            self._space.remove(self._bonds.pop(pair))


def _moment(sheet: RobotSheet, mass: float) -> float:
    if sheet.shape == "circle":
        return float(pymunk.moment_for_circle(mass, 0.0, 0.5 * sheet.length))
    return float(pymunk.moment_for_box(mass, (sheet.length, sheet.width)))


def _outline(sheet: RobotSheet, body: pymunk.Body) -> pymunk.Shape:
    if sheet.shape == "circle":
        return pymunk.Circle(body, 0.5 * sheet.length)
    if sheet.shape == "capsule":
        half = 0.5 * (sheet.length - sheet.width)
        return pymunk.Segment(body, (-half, 0.0), (half, 0.0), 0.5 * sheet.width)
    rounding = BOX_ROUNDING * sheet.width
    size = (sheet.length - 2.0 * rounding, sheet.width - 2.0 * rounding)
    return pymunk.Poly.create_box(body, size, rounding)
