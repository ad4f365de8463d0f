"""The Dec-POMDP of a batch of worlds: what is remembered between decisions, and what comes of each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.discretise.cells import Grid, progress_table
from robosim.discretise.modes import Mode, gripper_commands, modes
from robosim.discretise.observation import ObservationLayout, OwnState, write_own_state
from robosim.discretise.pheromone import PheromoneConfig, PheromoneMap
from robosim.discretise.reward import RewardConfig, rewards
from robosim.robot.drivers import STOP
from robosim.world.state import LOOSE, WorldState

TWO_PI = 2.0 * np.pi
COLLISION = np.uint8(Mode.COLLISION)
BLOCKED_SHARE = 0.25
"""A robot that touches something and makes less than this share of its free motion is blocked."""
SIGHT = 2.0
"""How far to each side a robot sees a loose pellet, in cells; only the expanded encoding uses it."""


class DecPomdp:
    """Turns world states into modes, pheromones, observations and rewards, [envs, robots, ...]."""

    def __init__(
        self,
        arena: Arena,
        robots: int,
        num_envs: int,
        layout: ObservationLayout,
        reward: RewardConfig,
        pheromone: PheromoneConfig,
    ) -> None:
        shape = (num_envs, robots)
        self.layout = layout
        self._arena = arena
        self._reward = reward
        self.grid = Grid(arena, margin=max(pheromone.radius, 1))
        self.pheromone = PheromoneMap(self.grid, num_envs, pheromone)
        self.mode = np.zeros(shape, dtype=np.uint8)
        """[envs, robots] without collisions."""
        self.shown_mode = np.zeros(shape, dtype=np.uint8)
        """[envs, robots] with Collision overlaid."""
        self.blocked = np.zeros(shape, dtype=np.bool_)
        """[envs, robots] in Collision."""
        self.collided = np.zeros(shape, dtype=np.bool_)
        """[envs, robots] touched another robot while under way in the last decision."""
        self.collisions = np.zeros(shape, dtype=np.int64)
        """[envs, robots] collisions since the last change of mode."""
        self.in_place = np.zeros(shape, dtype=np.int64)
        """[envs, robots] decisions without making way, for whatever reason."""
        self.previous_action = np.full(shape, STOP, dtype=np.int64)
        self.density = np.zeros(num_envs)
        """[envs] robots per cell of tunnel length."""
        self._cell = np.zeros(shape, dtype=np.int64)
        self._laden = np.zeros(shape, dtype=np.bool_)
        self._place = np.zeros((*shape, 2))
        self._heading = np.zeros(shape)
        self._distances = np.zeros((*shape, 2))
        self._paid = np.zeros((num_envs, arena.pellets.count), dtype=np.bool_)
        width, height = arena.size
        self._per_size = np.array([1.0 / width, 1.0 / height])
        self._progress = progress_table(self.grid, arena)
        self._first_pellet = arena.pellets.count * np.arange(num_envs)[:, None]
        self._per_sight = 1.0 / (SIGHT * arena.cell_size)
        self._per_farthest = 1.0 / float(arena.distances.raster.max())
        sheet, period = arena.robot, arena.timing.decision_period
        self._per_way = 1.0 / (sheet.top_speed * period)
        self._still_way = BLOCKED_SHARE * sheet.top_speed * period
        self._still_turn = BLOCKED_SHARE * sheet.top_turn_rate * period

    def reset(self, state: WorldState) -> None:
        """Begin an episode in every environment from the worlds' state."""
        self.pheromone.reset()
        shape = state.held.shape
        self.blocked = np.zeros(shape, dtype=np.bool_)
        self.collided = np.zeros(shape, dtype=np.bool_)
        self.collisions = np.zeros(shape, dtype=np.int64)
        self.in_place = np.zeros(shape, dtype=np.int64)
        self.previous_action = np.full(shape, STOP, dtype=np.int64)
        self._paid.fill(False)
        self._locate(state)
        self._set_modes(state)
        self.shown_mode = self.mode.copy()

    def gripper_commands(self) -> NDArray[np.int8]:
        """Return what the modes tell the grippers to do in the next decision, [envs, robots]."""
        return gripper_commands(self.mode)

    def update(self, actions: NDArray[np.int64], state: WorldState) -> NDArray[np.float64]:
        """Take in what `actions` [envs, robots] have led to; returns the rewards [envs, robots]."""
        was_laden, was_mode, was_distances = self._laden, self.mode, self._distances
        was_place, was_heading = self._place, self._heading
        under_way = actions != STOP
        self._locate(state)
        self._set_modes(state)

        turned = self._heading - was_heading
        turned = np.abs(turned - TWO_PI * np.rint(turned * (1.0 / TWO_PI)))
        way = self._place - was_place
        way *= way
        in_place = way[..., 0] + way[..., 1] < self._still_way**2
        self.in_place = (self.in_place + 1) * in_place
        still = in_place & (turned < self._still_turn)
        other_robot, wall, pellet = state.touched
        self.blocked = under_way & still & (other_robot | wall | pellet)
        self.shown_mode = np.where(self.blocked, COLLISION, self.mode)
        self.collided = under_way & other_robot
        self.collisions = self.collisions * (self.mode == was_mode) + self.collided
        self.previous_action = actions.copy()

        gained = was_distances - self._distances
        progress = np.where(was_laden, gained[..., 0], gained[..., 1])
        reward = rewards(
            self._reward,
            progress=progress * self._per_way,
            collided=self.collided,
            laden=was_laden,
            pickups=self._first_pickups(state),
            deliveries=state.deliveries,
            idle=in_place,
        )
        self.pheromone.update(self._cell, self.shown_mode, self._laden, actions)
        return reward

    def observe(self, state: WorldState) -> NDArray[np.float32]:
        """Return the observations [envs, robots, size] in a fresh array."""
        out = np.empty((*self._cell.shape, self.layout.size), dtype=np.float32)
        expanded = self.layout.encoding == "expanded"
        own = OwnState(
            mode=self.shown_mode,
            laden=self._laden,
            place=self._place * self._per_size,
            heading=self._heading,
            offset=self._offset,
            previous_action=self.previous_action,
            collisions=self.collisions,
            distances=self._distances * self._per_farthest,
            free_neighbours=self.grid.free_neighbours(self._cell) if expanded else None,
            in_place=self.in_place,
            progress=self._progress.take(self._cell, axis=0) if expanded else None,
            pellet=self._pellet_in_sight(state) if expanded else None,
        )
        end = write_own_state(self.layout, own, out)
        if self.layout.stigmergy:
            self.pheromone.read(self._cell, out[..., end:-1])
            np.minimum(self.density, 1.0, out=out[..., -1].T)
        return out

    def _pellet_in_sight(self, state: WorldState) -> NDArray[np.float64]:
        """Return whether a loose pellet is within `SIGHT`, and where from the robot, [envs, robots, 3]."""
        seen = np.zeros((*self._cell.shape, 3))
        if state.pellets.size:
            nearest = state.nearest + self._first_pellet
            apart = state.pellets.reshape(-1, 2).take(nearest, axis=0)
            apart -= self._place
            apart *= self._per_sight
            inside = np.abs(apart) <= 1.0
            near = inside[..., 0] & inside[..., 1]
            near &= state.pellet_status.take(nearest) == LOOSE
            seen[..., 0] = near
            np.multiply(apart, seen[..., :1], out=seen[..., 1:])
        return seen

    def _locate(self, state: WorldState) -> None:
        self._place = state.pose[..., :2].copy()
        self._heading = state.pose[..., 2].copy()
        coordinates = self.grid.cell_coordinates(self._place)
        self._cell = self.grid.flat_index(coordinates)
        self._offset = 2.0 * (coordinates - np.floor(coordinates)) - 1.0
        self._laden = state.held >= 0
        self._distances = self._arena.distances.sample(self._place)
        self.density = self.grid.tunnel_density(self._cell)

    def _set_modes(self, state: WorldState) -> None:
        self.mode = modes(self.grid.zones.take(self._cell), self._laden, state.touching >= 0)

    def _first_pickups(self, state: WorldState) -> NDArray[np.int64]:
        """Return which robots took a pellet that nobody has been paid for, and mark it as paid."""
        taken = state.picked >= 0
        first = taken.astype(np.int64)
        self._paid[state.fresh] = False
        if np.count_nonzero(taken):
            envs, robots = np.nonzero(taken)
            pellets = state.picked[envs, robots]
            first[envs, robots] = ~self._paid[envs, pellets]
            self._paid[envs, pellets] = True
        return first
