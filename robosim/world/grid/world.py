"""The grid world: robots on cells, in batches, and in the same terms as the physical world.

A decision lasts as long as a cell at top speed. A robot that moves is in the next cell at its end, with its
heading along the move (`cardinal`) or as it was (`wheels`, where a spin turns by a right angle). A refused
robot keeps its pose, heading too, and shows the mode Collision until a move of its succeeds: whether a robot
or a wall refused it, and whether it chooses Stop meanwhile. Only the robot whose own move is refused has
touched the other; the contact lists both. Who is refused is in `robosim.world.grid.conflicts`.

A pellet is a point in a cell. The robot that is in that cell touches it and can take it, at the end of a
decision, when all moves are done. Pellets block nobody, and none is ever torn loose.

There are no forces: impulses and the energy at the wheels are NaN, and masses, friction, traction, differing
top speeds and how far a gripper reaches mean nothing here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.errors import InputError, refused
from robosim.robot.drivers import ACTION_NAMES, CARDINAL_STEPS, STOP, ActionKind
from robosim.robot.team import Team
from robosim.world.contacts import ContactKind, Contacts, no_contacts
from robosim.world.draws import draw_episode
from robosim.world.grid.conflicts import Crowd, Outcome
from robosim.world.grid.layout import cells_at, grid_arena, middles
from robosim.world.grid.lots import Lots
from robosim.world.grid.pellets import PelletStore
from robosim.world.motion import (
    EXACT,
    LateCommands,
    MotionConfig,
    MotionDraws,
    draw_motion,
    require_meaning_on_grid,
)
from robosim.world.spacing import closest_on_the_path, to_nearest
from robosim.world.state import Gripper, blank_state

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

QUARTERS = 4
"""Headings: east, north, west and south, a right angle apart."""
HEADING = np.array([0.0, 0.5 * np.pi, -np.pi, -0.5 * np.pi])
"""[4] rad, in [-pi, pi)."""
FORWARD = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
"""[4, 2] steps (columns, rows) along each heading."""
CARDINAL_QUARTERS = (1, 3, 2, 0)
"""Headings of the moves to north, south, west and east."""
NOSE = 0.45
"""A held pellet is shown this far ahead at most, in cells: inside the robot's own."""


class GridWorld:
    """Robots on cells, one a cell."""

    def __init__(
        self,
        arena: Arena,
        robots: int,
        num_envs: int,
        actions: ActionKind,
        pellet_gradient: float = 0.0,
        motion: MotionConfig = EXACT,
    ) -> None:
        """`pellet_gradient` is explained in `robosim.world.draws.draw_pellets`."""
        require_meaning_on_grid(motion)
        if actions == "wheels-9":
            raise refused("actions", actions, '"cardinal" or "wheels" in the grid, which turns by quarters')
        self.arena = grid_arena(arena)
        if robots > self.arena.capacity:
            room = f"the room in arena {arena.name!r} in the grid, one robot a cell"
            raise refused("robots", robots, f"a whole number from 1 to {self.arena.capacity}, {room}")
        self._pellet_gradient = pellet_gradient
        self._motion = motion
        self._late: LateCommands | None = None
        self.drawn: Sequence[MotionDraws] = ()
        self.robots = robots
        self.team = arena.team(robots)
        _require_alike(self.team)
        self.num_envs = num_envs
        self.on_cells = True
        self.travel: Floats | float = arena.cell_size
        self.turn: Floats | float = np.pi if actions == "cardinal" else 0.5 * np.pi
        shape = (num_envs, robots)
        self.state = blank_state(num_envs, robots, arena.pellets.count)
        # Nothing slips here.
        self.state.odometry = self.state.pose
        self.contacts = no_contacts()
        self.wheel_energy: Floats = np.full(shape, np.nan)
        self.closest: Floats = np.full(shape, np.inf)
        self._metered = False
        self._num_actions = len(ACTION_NAMES[actions])
        self._step_of, self._heading_after = _moves(actions, arena.columns)
        centre = middles(arena)
        self._centre = centre
        headings = np.tile(HEADING, len(centre))[:, None]
        self._poses = np.concatenate([centre.repeat(QUARTERS, axis=0), headings], axis=1)
        """[cells * 4, 3] by cell and heading."""
        offset = min(0.5 * self.team.sheets[0].length, NOSE * arena.cell_size)
        self._noses = self._poses[:, :2] + offset * np.tile(FORWARD, (len(centre), 1))
        """[cells * 4, 2] where a robot's gripper is."""
        turned = HEADING[:, None] - HEADING
        self._per_period = 1.0 / self.arena.timing.decision_period
        self._turn_rate = (turned - 2.0 * np.pi * np.rint(turned / (2.0 * np.pi))).ravel() * self._per_period
        """[4 * 4] rad/s, from the second heading to the first; half a turn counts with either sign."""
        self._cell = np.zeros(shape, dtype=np.int64)
        self._heading = np.zeros(shape, dtype=np.int64)
        self._nose = np.zeros((*shape, 2))
        self._crowd = Crowd((arena.zones != Zone.WALL).ravel(), num_envs, robots)
        self._pellets = PelletStore(self.arena, self.state)
        self._lots = Lots(robots)
        self._decisions = 0

    def meter(self) -> None:
        """Meter `closest` from now on; there are no wheels, so their energy stays NaN."""
        self._metered = True
        np.minimum(self.closest, to_nearest(self.state.pose), out=self.closest)

    def count_turns(self) -> None:
        """Nothing is left to do: a robot always knows which move it has made."""

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Begin an episode in every environment; everything random in it comes from its one of `seeds`."""
        state = self.state
        rngs = [np.random.default_rng(seed) for seed in seeds]
        spots = np.zeros(state.pellet_status.shape, dtype=np.int64)
        for env, rng in enumerate(rngs):
            draws, _ = draw_episode(self.arena, self.robots, rng, self._pellet_gradient)
            self._cell[env] = cells_at(self.arena, draws.robot_pose[:, :2])
            quarter = np.rint(draws.robot_pose[:, 2] * (2.0 / np.pi))
            self._heading[env] = quarter.astype(np.int64) % QUARTERS
            spots[env] = draws.pellet_spot
        self._lots.reset(rngs)
        self._decisions = 0
        self.drawn = [draw_motion(self._motion, self.robots, seed) for seed in seeds]
        if self._motion.late:
            period, idle = self.arena.timing.decision_period, np.full(self._cell.shape, STOP, dtype=np.int64)
            self._late = LateCommands(self._motion, self.drawn, seeds, period, 1, idle)
        self._crowd.place(self._cell)
        for nothing in (state.held, state.touching, state.picked):
            nothing.fill(-1)
        for cleared in (
            state.touched, state.lost, state.fresh, state.velocity, state.deliveries, state.delivered,
            state.refilled, state.refused,
        ):  # fmt: skip
            cleared.fill(0)
        self._show()
        self.closest = to_nearest(state.pose) if self._metered else np.full_like(self.closest, np.inf)
        self._pellets.reset(spots)
        self._pellets.feel(self._cell, self._nose)
        self.contacts = no_contacts()

    def step(self, actions: Integers, gripper: NDArray[np.int8], believed: Floats | None = None) -> None:
        """Advance all environments by one decision: actions and gripper commands are [envs, robots].

        Moves go from cell to cell, wherever robots take themselves to be: `believed` changes nothing.
        """
        if self._late is not None:
            self._late.send(actions, self._decisions)
            actions = self._late.received(self._decisions)
        self._decisions += 1
        order, chance = self._lots.draw()
        choice = self._heading * self._num_actions + actions
        target = self._cell + self._step_of.take(choice)
        outcome = self._crowd.move(self._cell, target, order)
        self._list_contacts(target, outcome)
        refused = outcome.walled | outcome.met
        heading = np.where(refused, self._heading, self._heading_after.take(choice))
        np.take(self._turn_rate, heading * QUARTERS + self._heading, out=self.state.velocity[..., 2])
        self._heading = heading
        self._cell = np.where(outcome.moved, target, self._cell)
        refused |= self.state.refused
        np.greater(refused, outcome.moved, out=self.state.refused)
        before = self.state.pose.copy()
        self._show()
        if self._metered:
            np.minimum(self.closest, closest_on_the_path(before, self.state.pose), out=self.closest)
        np.subtract(self.state.pose[..., :2], before[..., :2], out=self.state.velocity[..., :2])
        self.state.velocity[..., :2] *= self._per_period
        self._handle_pellets(gripper, chance)

    def _show(self) -> None:
        """Bring the poses to where the robots are."""
        key = self._cell * QUARTERS + self._heading
        np.take(self._poses, key, axis=0, out=self.state.pose)
        np.take(self._noses, key, axis=0, out=self._nose)

    def _list_contacts(self, target: Integers, outcome: Outcome) -> None:
        """List the refused moves, on the border between the two cells, and mark whose they were."""
        state, crowd = self.state, self._crowd
        state.touched[ContactKind.ROBOT_ROBOT] = outcome.met
        state.touched[ContactKind.ROBOT_WALL] = outcome.walled
        env, robot = np.nonzero(outcome.met | outcome.walled)
        if not len(env):
            self.contacts = no_contacts()
            return
        met = outcome.met[env, robot]
        wanted, cell = target[env, robot], self._cell[env, robot]
        other = np.where(met, crowd.occupant(env, wanted), -1)
        # Two that wanted to exchange their cells have one contact, listed once.
        back = met & (target[env, other] == cell) & outcome.met[env, other]
        listed = ~(back & (other < robot))
        env, robot, other, met = env[listed], robot[listed], other[listed], met[listed]
        count = len(env)
        self.contacts = Contacts(
            env=env,
            time=np.full(count, self._decisions * self.arena.timing.decision_period),
            kind=np.where(met, ContactKind.ROBOT_ROBOT, ContactKind.ROBOT_WALL).astype(np.uint8),
            a=np.where(met, np.minimum(robot, other), robot),
            b=np.where(met, np.maximum(robot, other), -1),
            position=0.5 * (self._centre[wanted[listed]] + self._centre[cell[listed]]),
            impulse=np.full(count, np.nan),
        )

    def _handle_pellets(self, gripper: NDArray[np.int8], chance: Floats) -> None:
        state, pellets = self.state, self._pellets
        state.picked.fill(-1)
        state.deliveries.fill(0)
        state.fresh.fill(False)
        laden = state.held >= 0
        if np.count_nonzero(laden):
            pellets.carry(self._nose)
            opened = laden & (gripper == np.int8(Gripper.OPEN))
            if np.count_nonzero(opened):
                pellets.drop(opened, self._cell)
        pellets.refill(self._cell, chance)
        pellets.feel(self._cell, self._nose)
        takers = (gripper == np.int8(Gripper.TAKE)) & (state.touching >= 0)
        if np.count_nonzero(takers):
            envs = pellets.take(takers, self._cell)
            pellets.carry(self._nose)
            pellets.feel_again(envs, self._cell, self._nose)


def _require_alike(team: Team) -> None:
    """Raise InputError for robots of unlike data sheets."""
    unlike = [one.name for one in team.groups if one.sheet != team.groups[0].sheet]
    if unlike:
        raise InputError(
            f"groups: {unlike[0]} has another data sheet than {team.groups[0].name}, but all must have the "
            "same in the grid, where robots have no bodies and drive a cell in a decision."
        )


def _moves(actions: ActionKind, columns: int) -> tuple[Integers, Integers]:
    """Return steps of the flat cell index and headings after them, [4 * actions], by heading and action."""
    stride = np.array([1, columns])
    quarter = np.arange(QUARTERS)
    if actions == "cardinal":
        step = np.broadcast_to(CARDINAL_STEPS @ stride, (QUARTERS, len(CARDINAL_STEPS)))
        after = np.stack([*(np.full(QUARTERS, one) for one in CARDINAL_QUARTERS), quarter], axis=1)
    else:
        ahead, nothing = FORWARD @ stride, np.zeros(QUARTERS, dtype=np.int64)
        step = np.stack([ahead, -ahead, nothing, nothing, nothing], axis=1)
        turned = [quarter, quarter, (quarter + 1) % QUARTERS, (quarter - 1) % QUARTERS, quarter]
        after = np.stack(turned, axis=1)
    return step.ravel().astype(np.int64), after.ravel().astype(np.int64)
