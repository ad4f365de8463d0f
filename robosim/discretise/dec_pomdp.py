"""The Dec-POMDP of a batch of worlds: what is remembered between decisions, and what comes of each.

What the robots sense gives modes, pheromones and observations; what is true gives rewards and metrics
(`Truth`). Without noise the two are one, and are computed once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.cells import Grid, gain_table
from robosim.discretise.goals import Goals
from robosim.discretise.location import Location, Locator
from robosim.discretise.modes import Mode, gripper_commands, modes
from robosim.discretise.noise import EXACT_READING, Reader, ReadingConfig
from robosim.discretise.observation import ObservationLayout, OwnState, write_own_state
from robosim.discretise.own_frame import Surroundings, turned
from robosim.discretise.pheromone import PheromoneConfig, PheromoneMap, SharedMemory
from robosim.discretise.reward import RewardConfig
from robosim.discretise.sensing import ExactSensor, Percept, Sensor
from robosim.discretise.truth import Bools, Motion, Truth, encounters
from robosim.robot.drivers import STOP
from robosim.robot.team import Role
from robosim.world.state import LOOSE, Setting, WorldState

COLLISION = np.uint8(Mode.COLLISION)
LEFT = 1.0 - 1e-6
"""Share of a cell's length at which a robot on wheel actions is no longer in place."""
SIGHT = 2.0
"""How far to each side a robot sees a loose pellet, in cells; only the expanded encoding uses it."""


class DecPomdp:
    """Turns world states into modes, pheromones, observations and rewards, [envs, robots, ...]."""

    def __init__(
        self,
        setting: Setting,
        layout: ObservationLayout,
        reward: RewardConfig,
        pheromone: PheromoneConfig,
        sensor: Sensor | None = None,
        reading: ReadingConfig = EXACT_READING,
        memory: SharedMemory | None = None,
    ) -> None:
        """Without a `sensor` the robots perceive the world as it is; `reading` is of the pheromone map.

        Without a `memory` the pheromone map is one of its own, with the constants of `pheromone`.
        """
        arena, num_envs = setting.arena, setting.num_envs
        shape = (num_envs, setting.robots)
        self.layout = layout
        self.grid = Grid(arena, margin=max(pheromone.radius, 1))
        self.pheromone = PheromoneMap(self.grid, num_envs, pheromone, layout.num_actions)
        """The map of this team; stays as it is where robots use a `memory` elsewhere."""
        self._memory: SharedMemory = memory or self.pheromone
        self.truth = Truth(setting, reward)
        """Rewards, and who collided and was blocked."""
        self.mode = np.zeros(shape, dtype=np.uint8)
        """[envs, robots] without collisions."""
        self.shown_mode = np.zeros(shape, dtype=np.uint8)
        """[envs, robots] with Collision overlaid."""
        self.collisions = np.zeros(shape, dtype=np.int64)
        """[envs, robots] collisions noticed since the last change of mode."""
        self.in_place = np.zeros(shape, dtype=np.int64)
        """[envs, robots] decisions in place, for whatever reason (`_stay`)."""
        self._left = np.zeros((*shape, 2))
        """[envs, robots, 2] m, where robots that drive themselves were when it was 0 last."""
        self.previous_action = np.full(shape, STOP, dtype=np.int64)
        self.density = np.zeros(num_envs)
        """[envs] robots in the tunnel per cell of its length, in truth."""
        self._sensor = ExactSensor() if sensor is None else sensor
        self._reader = None if reading == EXACT_READING or not layout.patch else Reader(reading)
        self._patch = np.empty(0, dtype=np.float32)
        self._kind = np.eye(len(setting.team.groups), dtype=np.float32)[setting.team.group]
        team = setting.team
        self._role = None if team.all_round else team.role
        goals = Goals(arena, team)
        self._locator = Locator(setting, self.grid, goals)
        self._percept: Percept
        self._true: Location
        self._seen: Location
        roles = [Role.ALL_ROUND] if team.all_round else list(Role)
        self._gains = np.concatenate([gain_table(self.grid, arena, role) for role in roles])
        self._surroundings = Surroundings(self.grid, goals, team)
        self._first_pellet = arena.pellets.count * np.arange(num_envs)[:, None]
        width, height = arena.size
        self._per_size = np.array([1.0 / width, 1.0 / height])
        self._per_sight = 1.0 / (SIGHT * arena.cell_size)
        self._per_farthest = 1.0 / goals.farthest

    def reset(self, state: WorldState, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Begin an episode in every environment from the worlds' state; sensors draw from `seeds`."""
        self._memory.reset()
        shape = state.held.shape
        self.collisions = np.zeros(shape, dtype=np.int64)
        self.in_place = np.zeros(shape, dtype=np.int64)
        self.previous_action = np.full(shape, STOP, dtype=np.int64)
        self.truth.reset(state)
        self._sensor.reset(seeds)
        self._sense(state)
        self._left = self._seen.position.copy()
        self.shown_mode = self.mode.copy()
        if self._reader is not None:
            self._reader.reset(seeds)
            self._patch = self._reader.read(self._around_on_map())

    @property
    def believed(self) -> NDArray[np.float64] | None:
        """[envs, robots, 3] where robots take themselves to be; None where that is where they are."""
        return None if self._seen is self._true else self._percept.pose

    def gripper_commands(self) -> NDArray[np.int8]:
        """Return what the modes command the grippers to do in the next decision, [envs, robots]."""
        return gripper_commands(self.mode)

    def update(self, actions: NDArray[np.int64], state: WorldState) -> NDArray[np.float64]:
        """Take in what `actions` [envs, robots] have led to; returns the rewards [envs, robots]."""
        was_true, was_seen = self._true, self._seen
        self._sense(state)
        motion = self._motion(was_true, self._true)
        truth = self.truth
        reward = truth.judge(actions, state, was_true, self._true, motion)
        percept = self._percept
        exact = percept.touched is state.touched and percept.refused is state.refused
        if exact and self._seen is self._true:
            self._notice(actions, motion, truth.collided, truth.blocked)
        else:
            seen_motion = self._motion(was_seen, self._seen)
            met = encounters(actions, percept.touched, percept.refused, seen_motion)
            self._notice(actions, seen_motion, *met)
        return reward

    def _sense(self, state: WorldState) -> None:
        percept = self._sensor.sense(state)
        self._percept = percept
        self._true = self._locator.locate(state.pose)
        self.density = self.grid.tunnel_density(self._true.cell)
        self._seen = self._true if percept.pose is state.pose else self._locator.locate(percept.pose)
        self._was_mode = self.mode
        self.mode = modes(self.grid.zones.take(self._seen.cell), percept.laden, percept.at_pellet, self._role)

    def _motion(self, before: Location, now: Location) -> Motion:
        locator = self._locator
        return Motion(locator.hardly_displaced(before, now), locator.hardly_turned(before, now))

    def _notice(self, actions: NDArray[np.int64], motion: Motion, collided: Bools, blocked: Bools) -> None:
        """Bring up to date what the robots know of themselves, and leave their marks in the pheromone map."""
        self.in_place = (self.in_place + 1) * self._stay(motion)
        self.shown_mode = np.where(blocked, COLLISION, self.mode)
        self.collisions = self.collisions * (self.mode == self._was_mode) + collided
        self.previous_action = actions.copy()
        self._memory.update(self._seen.cell, self.shown_mode, self._percept.laden, actions)
        if self._reader is not None:
            self._patch = self._reader.read(self._around_on_map())

    def _stay(self, motion: Motion) -> Bools:
        """Return who is still in place, [envs, robots].

        That is who was hardly displaced; with wheel actions, who is within a cell's length of where it
        began to count: two wheels drive a robot to and fro over a few centimetres for good, and it would
        count from 0 with each such move.
        """
        if not self.layout.own_frame:
            return motion.displaced_little
        position = self._seen.position
        apart = position - self._left
        # A cell's length itself counts as left, however the difference of two places is rounded.
        near: Bools = (apart * apart).sum(axis=-1) < (LEFT * self.grid.cell_size) ** 2
        self._left = np.where(near[..., None], self._left, position)
        return near

    def observe(self) -> NDArray[np.float32]:
        """Return the observations [envs, robots, size] in a fresh array."""
        seen, percept = self._seen, self._percept
        layout = self.layout
        out = np.empty((*seen.cell.shape, layout.size), dtype=np.float32)
        expanded = layout.encoding == "expanded"
        free, gain = self._around() if expanded else (None, None)
        own = OwnState(
            mode=self.shown_mode,
            laden=percept.laden,
            position=seen.position * self._per_size,
            heading=seen.heading,
            offset=2.0 * (seen.coordinates - np.floor(seen.coordinates)) - 1.0,
            previous_action=self.previous_action,
            collisions=self.collisions,
            distances=seen.distances * self._per_farthest,
            free_neighbours=free,
            in_place=self.in_place,
            gain=gain,
            pellet=self._pellet_in_sight() if expanded else None,
            kind=self._kind,
        )
        end = write_own_state(layout, own, out)
        if layout.patch:
            patch = out[..., end : end + self._memory.patch_size]
            if self._reader is None:
                self._read_map(patch)
            else:
                patch[...] = self._patch
        if layout.density:
            known = seen is self._true and self._memory is self.pheromone
            density = self.density if known else self._memory.tunnel_density(seen.cell)
            np.minimum(density, 1.0, out=out[..., -1].T)
        return out

    def _read_map(self, out: NDArray[np.float32]) -> None:
        """Write what is on the pheromone map around where robots take themselves to be."""
        self._memory.read(self._seen.cell, out, self._seen.heading if self.layout.own_frame else None)

    def _around_on_map(self) -> NDArray[np.float32]:
        patch = np.empty((*self._seen.cell.shape, self._memory.patch_size), dtype=np.float32)
        self._read_map(patch)
        return patch

    def _around(self) -> tuple[Bools | None, NDArray[np.float64]]:
        """Return free neighbours and gains, [envs, robots, 8] each, of the map's sides or the robot's own."""
        seen, layout = self._seen, self.layout
        if layout.own_frame:
            return self._surroundings.look(seen)
        free = self.grid.free_neighbours(seen.cell) if layout.neighbours else None
        row = seen.cell if self._role is None else seen.cell + self.grid.size * self._role
        return free, self._gains.take(row, axis=0)

    def _pellet_in_sight(self) -> NDArray[np.float64]:
        """Return whether a loose pellet is within `SIGHT`, and where from the robot, [envs, robots, 3]."""
        percept = self._percept
        visible = np.zeros((*percept.laden.shape, 3))
        if percept.pellets.size:
            nearest = percept.nearest + self._first_pellet
            apart = percept.pellets.reshape(-1, 2).take(nearest, axis=0)
            apart -= self._seen.position
            apart *= self._per_sight
            if self.layout.own_frame:
                apart = turned(apart, self._seen.heading)
            inside = np.abs(apart) <= 1.0
            near = inside[..., 0] & inside[..., 1]
            near &= percept.pellet_status.take(nearest) == LOOSE
            visible[..., 0] = near
            np.multiply(apart, visible[..., :1], out=visible[..., 1:])
        return visible
