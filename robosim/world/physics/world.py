"""The physical world: a batch of pymunk spaces behind arrays [envs, robots, ...]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robosim.arena.checks import MOST_WORK
from robosim.arena.model import Arena, Zone
from robosim.errors import refused
from robosim.robot.drivers import ActionKind, make_driver
from robosim.robot.kinematics import body_twist, driven, slew, wrap_angle
from robosim.robot.team import per_wheel
from robosim.world.contacts import no_contacts
from robosim.world.draws import Draws, draw_episode, room_apart
from robosim.world.motion import EXACT, MotionConfig, MotionDraws, draw_motion, with_motion
from robosim.world.physics.bodies import Bodies
from robosim.world.physics.contacts import ContactLog, lasting, mark_touched, touching_pellets
from robosim.world.physics.motors import Motors
from robosim.world.physics.space import EpisodeSpace
from robosim.world.spacing import closest_on_the_path, to_nearest
from robosim.world.state import ABSENT, HELD, LOOSE, Gripper, blank_state

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

TEAR_DISTANCE = 1.0
"""A held pellet pushed this far out of the gripper is torn loose, in pellet radii."""
REFILL_MARGIN = 1e-3
"""Gap kept around a fresh pellet, m."""
NOBODY = np.array(-1)
"""In place of a pellet, where there is none."""
TINY = np.array(1e-300)
"""Keeps sin(x) / x defined at 0, and changes no other value of x."""
OPEN, TAKE = np.int8(Gripper.OPEN), np.int8(Gripper.TAKE)


class PhysicsWorld:
    """Robots and pellets as rigid bodies; robots move only by wheel commands within their data sheet."""

    ramps = False
    """Whether wheels always change their speed in every substep, not only for a `motion` that asks."""

    def __init__(
        self,
        arena: Arena,
        robots: int,
        num_envs: int,
        actions: ActionKind,
        pellet_gradient: float = 0.0,
        motion: MotionConfig = EXACT,
        keep_distance: float | None = None,
    ) -> None:
        """`pellet_gradient` is explained in `robosim.world.draws.draw_pellets`, the rest in `make_world`."""
        if robots > arena.capacity:
            room = f"a whole number from 1 to {arena.capacity}, the room in arena {arena.name!r}"
            raise refused("robots", robots, room)
        substeps = arena.timing.control_steps * arena.timing.substeps
        if robots * substeps > MOST_WORK:
            room = f"a whole number from 1 to {MOST_WORK // substeps}"
            raise refused("robots", robots, f"{room} where a decision has {substeps} substeps")
        if keep_distance is not None and robots > (most := room_apart(arena, keep_distance)):
            room = f"a whole number from 1 to {most}, the room in arena {arena.name!r} at keep_distance"
            raise refused("robots", robots, f"{room} {keep_distance:g}")
        self.arena = arena
        self._keep_distance = keep_distance
        self.pellet_gradient = pellet_gradient
        self.robots = robots
        self.team = arena.team(robots)
        self.num_envs = num_envs
        sheet, timing = self.team.sheet, arena.timing
        self._driver = make_driver(
            actions,
            sheet,
            arena.zones != Zone.WALL,
            arena.cell_size,
            timing.control_period,
            timing.decision_period,
            keep_distance,
        )
        # Arrays of one number, where robots are alike: numpy takes them much faster than Python's.
        self._max_change = per_wheel(sheet.max_wheel_acceleration * timing.control_period)
        self._half_period = np.array(0.5 * timing.control_period)
        self.motion = motion
        self._motors: Motors | None = None
        self.drawn: Sequence[MotionDraws] = ()
        self._gripper_offset = 0.5 * sheet.length
        self._gripper_reach = arena.pellets.radius + sheet.gripper_reach
        self._home = (arena.zones == Zone.HOME).ravel()
        shape = (num_envs, robots)
        pellets = arena.pellets.count
        self.state = blank_state(num_envs, robots, pellets)
        self.contacts = no_contacts()
        self.travel = sheet.top_speed * timing.decision_period
        self.on_cells = False
        self.turn = sheet.top_turn_rate * timing.decision_period
        self.wheel_speeds: Floats = np.zeros((*shape, 2))
        """[envs, robots, 2] wheel speeds held in the last control period, rad/s."""
        self.wheel_energy: Floats = np.zeros(shape)
        """[envs, robots] energy lost at the wheels in the episode so far, J; 0 without `meter`."""
        self.closest: Floats = np.full(shape, np.inf)
        self._metered = False
        self._counts_turns = False
        self._traction = np.zeros(shape)
        self._max_speed = np.zeros((*shape, 1))
        self._commands = np.zeros((*shape, 3))
        self._driven = np.zeros((*shape, 3))
        self._anchor_x = np.zeros(shape)
        self._anchor_y = np.zeros(shape)
        self._first_pellet = pellets * np.arange(num_envs)[:, None]
        self._first_distance = pellets * np.arange(num_envs * robots).reshape(shape)
        self._holder = np.full((num_envs, pellets), -1)
        self._last_holder = np.full((num_envs, pellets), -1)
        self._control_steps = np.zeros(num_envs, dtype=np.int64)
        self._spaces: list[Bodies] = []
        self._rngs: list[np.random.Generator] = []
        # Ids of all pellets and grounds, sorted, and the slot of each: a ground has its environment's last.
        self._listed_ids = np.zeros(0, dtype=np.uintp)
        self._slot_of_rank = np.zeros(0, dtype=np.intp)
        self._slots = np.zeros((num_envs, pellets + 1, 2))
        self._log = ContactLog(num_envs, robots, pellets, timing.control_steps)

    @property
    def spaces(self) -> Sequence[Bodies]:
        """The bodies of each environment's present episode, for measurements and tests."""
        return self._spaces

    def meter(self) -> None:
        """Meter `closest` and `wheel_energy` from now on: what Coulomb friction under slipping wheels takes.

        Force times distance of slip, and torque times angle: wheels slip while they speed up or slow down a
        robot, and while it is held up. Nothing else brakes a robot here and braking gives nothing back, so
        this is all that the motors put out, but for what robots pass on by pushing. Costs a few per cent.
        """
        self._metered = True
        if self._spaces:
            np.minimum(self.closest, to_nearest(self.state.pose), out=self.closest)

    def count_turns(self) -> None:
        """Keep the state's `odometry` from now on: what the wheels turn, whether they slip or not."""
        self._counts_turns = True

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Begin an episode in every environment; everything random in it comes from its one of `seeds`."""
        self._rngs = [np.random.default_rng(seed) for seed in seeds]
        self.drawn = [draw_motion(self.motion, self.robots, seed) for seed in seeds]
        if self.motion != EXACT or self.ramps:
            self._motors = Motors(self.motion, self.drawn, seeds, self.team, self.arena.timing)
        self._commands[...] = 0.0
        self._spaces = [self._built(env, rng) for env, rng in enumerate(self._rngs)]
        self._log.know_bodies(np.stack([space.body_ids for space in self._spaces]))
        listed = np.concatenate(
            [np.append(space.body_ids[self.robots :], space.ground_id) for space in self._spaces]
        )
        self._slot_of_rank = np.argsort(listed)
        self._listed_ids = listed[self._slot_of_rank]
        state = self.state
        for nothing in (state.held, state.touching, state.picked, self._holder, self._last_holder):
            nothing.fill(-1)
        for cleared in (
            state.touched, state.lost, state.fresh, state.velocity, state.deliveries, state.delivered,
            state.odometry, state.refilled, state.refused, self.wheel_energy, self.wheel_speeds,
            self._control_steps,
        ):  # fmt: skip
            cleared.fill(0)
        state.pellet_status.fill(LOOSE)
        state.pellets[...] = self._slots[:, :-1]
        self.closest = to_nearest(state.pose) if self._metered else np.full_like(self.closest, np.inf)
        self._driver.reset(state.pose)
        self._feel_pellets(np.cos(state.pose[..., 2]), np.sin(state.pose[..., 2]))
        self.contacts = no_contacts()

    def _built(self, env: int, rng: np.random.Generator) -> Bodies:
        """Draw an environment's episode and build its bodies."""
        draws, speed_factor = draw_episode(
            self.arena, self.robots, rng, self.pellet_gradient, self._keep_distance, bodies=True
        )
        draws = with_motion(draws, self.drawn[env])
        space = self._new_bodies(draws, self._commands[env])
        self._traction[env] = self.team.sheet.traction_force * draws.robot_mass * draws.traction
        self._max_speed[env, :, 0] = self.team.sheet.max_wheel_speed * speed_factor
        self.state.pose[env] = draws.robot_pose
        self._slots[env, :-1] = draws.pellet_place
        return space

    def _new_bodies(self, draws: Draws, commands: Floats) -> Bodies:
        """Return an episode's bodies, which read `commands` [robots, 3] when they are driven."""
        return EpisodeSpace(self.arena, self.team, draws, commands)

    def step(self, actions: Integers, gripper: NDArray[np.int8], believed: Floats | None = None) -> None:
        """Advance all environments by one decision: actions and gripper commands are [envs, robots].

        Robots steer by where they take themselves to be, `believed` [envs, robots, 3], as the decision
        begins, and within it by their own motion, which their wheels tell them.
        """
        self.begin_decision()
        astray = None if believed is None else believed - self.state.pose
        self._driver.begin(self._felt(astray), actions)
        for _ in range(self.arena.timing.control_steps - 1):
            self.drive(self._driver.wheel_speeds(self._felt(astray)))
        self.end_decision(self._driver.wheel_speeds(self._felt(astray)), gripper)
        self.state.refused[...] = self._driver.held_back

    def begin_decision(self) -> None:
        """Forget the contacts of the decision before."""
        self._log.clear()
        for space in self._spaces:
            space.forget_contacts()

    def end_decision(self, wheel_speeds: Floats, gripper: NDArray[np.int8]) -> None:
        """Hold wheel speeds as `drive` does, for the last control period of a decision, and handle pellets.

        `step` is `begin_decision`, `drive` for every control period but one, and this.
        """
        before = self._motion() if self._metered else None
        self._push(wheel_speeds)
        self._read_bodies()
        if before is not None:
            self._meter(before)
        self._read_contacts()
        self._handle_pellets(gripper)

    def _felt(self, astray: Floats | None) -> Floats:
        return self.state.pose if astray is None else self.state.pose + astray

    def drive(self, wheel_speeds: Floats) -> None:
        """Hold wheel speeds [envs, robots, 2] (rad/s) for one control period, within the data sheet.

        Commands beyond the top speed or the acceleration are cut down to it. Contacts are logged
        for the decision; pellets are not handled.
        """
        if not self._metered:
            self._push(wheel_speeds)
            for env, space in enumerate(self._spaces):
                self.state.pose[env] = space.poses()[: self.robots]
            return
        before = self._motion()
        self._push(wheel_speeds)
        for env, space in enumerate(self._spaces):
            bodies = space.bodies()[1][: self.robots]
            self.state.pose[env] = bodies[:, :3]
            self.state.velocity[env] = bodies[:, 3:]
        self._meter(before)

    def _motion(self) -> tuple[Floats, Floats]:
        return self.state.pose.copy(), self.state.velocity.copy()

    def _meter(self, before: tuple[Floats, Floats]) -> None:
        """Meter a control period, at whose beginning pose and velocity were `before`."""
        self._meter_wheels(*before)
        np.minimum(self.closest, closest_on_the_path(before[0], self.state.pose), out=self.closest)

    def _meter_wheels(self, pose: Floats, velocity: Floats) -> None:
        """Add the loss of a control period that began at that pose and velocity."""
        timing, sheet = self.arena.timing, self.team.sheet
        driven = self._commands * timing.control_period if self._motors is None else self._driven
        slip = driven - (self.state.pose - pose)
        # The solver moves bodies by the velocity before a substep, so their displacement lags by half of one.
        slip -= (self.state.velocity - velocity) * (0.5 * timing.substep)
        slipped = np.hypot(slip[..., 0], slip[..., 1])
        slipped += 0.5 * sheet.wheel_base * np.abs(wrap_angle(slip[..., 2]))
        self.wheel_energy += self._traction * slipped

    def _push(self, wheel_speeds: Floats) -> None:
        """Do what `drive` does, but do not look where the bodies have come to."""
        motors, timing = self._motors, self.arena.timing
        if motors is not None:
            wheel_speeds = motors.geared(wheel_speeds)
            if motors.gradual or self.ramps:
                self._push_gradually(motors, wheel_speeds)
                return
        self.wheel_speeds = slew(self.wheel_speeds, wheel_speeds, self._max_speed, self._max_change)
        self._count(timing.control_period)
        self._command(self.state.pose[..., 2], self._half_period)
        if motors is not None:
            self._driven = self._commands * timing.control_period
        self._control_steps += 1
        for env, space in enumerate(self._spaces):
            space.drive()
            self._log.add(env, space.list_contacts())

    def _push_gradually(self, motors: Motors, wheel_speeds: Floats) -> None:
        """Do what `_push` does, with wheels that change their speed in every substep."""
        timing, robots = self.arena.timing, self.robots
        heading = self.state.pose[..., 2].copy()
        self._driven = np.zeros_like(self._commands)
        motors.send(wheel_speeds)
        for substep in range(timing.substeps):
            if substep:
                for env, space in enumerate(self._spaces):
                    heading[env] = space.poses()[:robots, 2]
            wanted = motors.wanted(self.wheel_speeds)
            self.wheel_speeds = slew(self.wheel_speeds, wanted, self._max_speed, motors.max_change)
            self._count(timing.substep)
            self._command(heading, motors.half_substep)
            self._driven += self._commands * timing.substep
            for space in self._spaces:
                space.drive_substep()
        self._control_steps += 1
        for env, space in enumerate(self._spaces):
            self._log.add(env, space.list_contacts())

    def _count(self, time: float) -> None:
        """Count the turns of the wheels while they hold their present speeds for a time (s)."""
        if self._counts_turns:
            twist = body_twist(self.team.sheet, self.wheel_speeds)
            self.state.odometry[...] = driven(self.state.odometry, *twist, time)

    def _command(self, heading: Floats, half: Floats) -> None:
        """Command the velocities that the wheel speeds give robots of a heading, for twice `half` s."""
        commands = self._commands
        speed, rate = body_twist(self.team.sheet, self.wheel_speeds)
        # The chord of the arc that the wheels describe: the end of the period is then exact.
        half_turn = rate * half
        chord = heading + half_turn
        half_turn += TINY
        speed *= np.sin(half_turn)
        speed /= half_turn
        np.multiply(speed, np.cos(chord), out=commands[..., 0])
        np.multiply(speed, np.sin(chord), out=commands[..., 1])
        commands[..., 2] = rate

    def _read_bodies(self) -> None:
        """Read robots and pellets, and fold the headings, at the end of a decision."""
        robots, state = self.robots, self.state
        pellet_ids, places = [], []
        for env, space in enumerate(self._spaces):
            ids, bodies = space.bodies()
            state.pose[env] = bodies[:robots, :3]
            state.velocity[env] = bodies[:robots, 3:]
            pellet_ids.append(ids[robots:])
            places.append(bodies[robots:, :2])
        # Bodies asleep move to the end of the solver's list, so each is found by its id.
        rank = self._listed_ids.searchsorted(_joined(pellet_ids))
        self._slots.reshape(-1, 2)[self._slot_of_rank[rank]] = _joined(places)
        state.pellets[...] = self._slots[:, :-1]
        state.pose[..., 2] = wrap_angle(state.pose[..., 2])

    def _read_contacts(self) -> None:
        times = self._control_steps * np.float64(self.arena.timing.control_period)
        touches = self._log.read(self._spaces, self._holder, times, self.arena.timing)
        state = self.state
        state.touched.fill(False)
        mark_touched(state.touched, touches)
        self.contacts = lasting(touches)
        if self.arena.pellets.cohesion > 0.0:
            for env, space in enumerate(self._spaces):
                space.cohere(touching_pellets(space, self.robots), state.pellets[env])

    def _handle_pellets(self, gripper: NDArray[np.int8]) -> None:
        state = self.state
        state.picked.fill(-1)
        state.lost.fill(False)
        state.deliveries.fill(0)
        state.fresh.fill(False)
        heading = state.pose[..., 2]
        cos, sin = np.cos(heading), np.sin(heading)
        laden = state.held >= 0
        if np.count_nonzero(laden):
            opened = laden & (gripper == OPEN)
            if np.count_nonzero(opened):
                self._drop(opened, torn=False)
                laden &= ~opened
            torn = laden & self._torn(cos, sin)
            if np.count_nonzero(torn):
                self._drop(torn, torn=True)
        self._deliver()
        waiting = state.pellet_status == ABSENT
        if np.count_nonzero(waiting):
            self._refill(waiting)
        self._feel_pellets(cos, sin)
        takers = (gripper == TAKE) & (state.touching >= 0)
        if np.count_nonzero(takers):
            self._take(takers)
            self._feel_pellets(cos, sin)

    def _torn(self, cos: Floats, sin: Floats) -> NDArray[np.bool_]:
        """Return whose pellets are pushed too far out, [envs, robots]; of laden robots only."""
        state = self.state
        # Held is -1 where a robot is not laden, which is some pellet too: its answer is not asked for.
        pellet = state.pellets.reshape(-1, 2).take(state.held + self._first_pellet, axis=0)
        apart = state.pose[..., :2] - pellet
        dx = cos * self._anchor_x - sin * self._anchor_y + apart[..., 0]
        dy = sin * self._anchor_x + cos * self._anchor_y + apart[..., 1]
        limit = TEAR_DISTANCE * self.arena.pellets.radius
        return np.asarray(dx * dx + dy * dy > limit * limit)

    def _drop(self, droppers: NDArray[np.bool_], *, torn: bool) -> None:
        state = self.state
        for env, robot in np.argwhere(droppers).tolist():
            pellet = int(state.held[env, robot])
            self._spaces[env].release(pellet)
            state.held[env, robot] = -1
            state.pellet_status[env, pellet] = LOOSE
            self._holder[env, pellet] = -1
            state.lost[env, robot] = torn

    def _deliver(self) -> None:
        """Count the loose pellets in the home and take them out of the world."""
        state = self.state
        cells = (state.pellets * (1.0 / self.arena.cell_size)).astype(np.intp)
        home = self._home.take(cells[..., 1] * self.arena.columns + cells[..., 0], mode="clip")
        home &= state.pellet_status == LOOSE
        if not np.count_nonzero(home):
            return
        for env, pellet in np.argwhere(home).tolist():
            robot = int(self._last_holder[env, pellet])
            if robot >= 0:
                state.deliveries[env, robot] += 1
            state.delivered[env] += 1
            state.pellet_status[env, pellet] = ABSENT
            self._last_holder[env, pellet] = -1
            self._spaces[env].take_out(pellet)

    def _feel_pellets(self, cos: Floats, sin: Floats) -> None:
        """Find the loose pellet nearest to each gripper, and whether the gripper touches it."""
        state = self.state
        if not state.pellet_status.size:
            return
        nose_x = state.pose[..., 0] + self._gripper_offset * cos
        nose_y = state.pose[..., 1] + self._gripper_offset * sin
        dx = state.pellets[:, None, :, 0] - nose_x[..., None]
        dy = state.pellets[:, None, :, 1] - nose_y[..., None]
        dx *= dx
        dy *= dy
        dx += dy
        np.copyto(dx, np.inf, where=(state.pellet_status != LOOSE)[:, None])
        nearest = dx.argmin(axis=2)
        felt = dx.ravel().take(nearest + self._first_distance) <= self._gripper_reach**2
        felt &= state.held < 0
        state.nearest = nearest
        state.touching = np.where(felt, nearest, NOBODY)

    def _take(self, takers: NDArray[np.bool_]) -> None:
        state = self.state
        for env, robot in np.argwhere(takers).tolist():
            pellet = int(state.touching[env, robot])
            if pellet < 0:
                continue
            self._anchor_x[env, robot], self._anchor_y[env, robot] = self._spaces[env].grip(robot, pellet)
            state.held[env, robot] = pellet
            state.picked[env, robot] = pellet
            state.pellet_status[env, pellet] = HELD
            self._holder[env, pellet] = robot
            self._last_holder[env, pellet] = robot
            # Other grippers that touch it are too late: it is no longer loose.
            state.touching[env][state.touching[env] == pellet] = -1

    def _refill(self, waiting: NDArray[np.bool_]) -> None:
        """Put fresh pellets to random places of the source that are clear of everything."""
        state = self.state
        for env, pellet in np.argwhere(waiting).tolist():
            place = self._free_place(env)
            if place is None:
                continue
            self._spaces[env].place(pellet, place)
            state.pellets[env, pellet] = place
            state.pellet_status[env, pellet] = LOOSE
            state.refilled[env] += 1
            state.fresh[env, pellet] = True

    def _free_place(self, env: int) -> Floats | None:
        """Return a random place of the source that is clear of everything, or None if there is none."""
        state, arena = self.state, self.arena
        others = np.concatenate(
            [state.pose[env, :, :2], state.pellets[env][state.pellet_status[env] != ABSENT]]
        )
        reach = np.full(len(others), 2.0 * arena.pellets.radius + REFILL_MARGIN)
        reach[: self.robots] = self.team.sheet.outer_radius + arena.pellets.radius + REFILL_MARGIN
        reach *= reach
        for choice in self._rngs[env].permutation(len(arena.pellet_places)).tolist():
            place: Floats = arena.pellet_places[choice]
            apart = others - place
            apart *= apart
            if (apart[:, 0] + apart[:, 1] >= reach).all():
                return place
        return None


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Return the parts one after another; a single one as it is."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
