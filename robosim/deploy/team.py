"""A team of real robots as discretisation and drivers know it: from readings to wheel speeds.

It needs numpy alone, since it also runs where nothing else of robosim is (`robosim.deploy.robotarium`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.deploy.readings import Bools, Floats, Readings, blank_team, take_in
from robosim.discretise.dec_pomdp import DecPomdp
from robosim.discretise.observation import ObservationLayout
from robosim.discretise.pheromone import PheromoneConfig, SharedMemory
from robosim.discretise.reward import RewardConfig
from robosim.discretise.walls import Walls
from robosim.robot.drivers import STOP, make_driver
from robosim.robot.kinematics import wrap_angle
from robosim.robot.team import Team, per_wheel
from robosim.world.state import Gripper

Act = Callable[[NDArray[np.float32], int], NDArray[np.int64]]
"""A policy: from observations [batch, robots, size] and the decision's number to actions [batch, robots]."""


@dataclass(slots=True, eq=False)
class _Setting:
    """One environment, and a pellet for each robot to know of."""

    arena: Arena
    num_envs: int
    robots: int
    team: Team
    travel: Floats | float
    turn: Floats | float


class RealTeam:
    """Decides for a team, and drives it; guards nothing, which is left to whoever calls."""

    def __init__(
        self,
        arena: Arena,
        robots: int,
        layout: ObservationLayout,
        reward: RewardConfig,
        pheromone: PheromoneConfig,
        act: Act,
        keep_distance: float | None = None,
        memory: SharedMemory | None = None,
    ) -> None:
        """`memory` is the pheromone map that is shared with others; without one the team has its own."""
        team, timing = arena.team(robots), arena.timing
        sheet = team.sheet
        setting = _Setting(
            arena=replace(arena, pellets=replace(arena.pellets, count=robots)),
            num_envs=1,
            robots=robots,
            team=team,
            travel=sheet.top_speed * timing.decision_period,
            turn=sheet.top_turn_rate * timing.decision_period,
        )
        self.arena = arena
        self.robots = robots
        self._act = act
        self._dec = DecPomdp(setting, layout, reward, pheromone, memory=memory)
        free = arena.zones != Zone.WALL
        self._driver = make_driver(
            layout.actions,
            sheet,
            free,
            arena.cell_size,
            timing.control_period,
            timing.decision_period,
            keep_distance,
        )
        self._walls = Walls(free, arena.cell_size)
        self._limit = per_wheel(sheet.max_wheel_speed)
        self._state = blank_team(robots)
        self.actions = np.full(robots, STOP)
        """[robots] the last that were decided; those of stopped robots are to stop."""
        self.gripper = np.full(robots, Gripper.KEEP, np.int8)
        """[robots] `Gripper`, what was decided with them, to be done at the end of the decision."""

    @property
    def occupancy(self) -> Floats:
        """[rows, columns] occupancy of the pheromone map, row 0 at the bottom; changes with decisions."""
        return np.asarray(self._dec.pheromone.occupancy[0])

    @property
    def shown_mode(self) -> NDArray[np.uint8]:
        """[robots] `Mode`, with COLLISION overlaid; changes with decisions."""
        return np.asarray(self._dec.shown_mode[0])

    @property
    def pose(self) -> Floats:
        """[robots, 3] where the robots were seen last, on the map."""
        return np.asarray(self._state.pose[0])

    def on_map(self, pose: Floats) -> Bools:
        """Return which of the poses [robots, 3] are finite and on the map, [robots]."""
        width, height = self.arena.size
        x, y = pose[:, 0], pose[:, 1]
        seen = np.isfinite(pose).all(axis=1)
        return np.asarray(seen & (x >= 0.0) & (x < width) & (y >= 0.0) & (y < height))

    def place(self, pose: Floats, on_map: Bools) -> None:
        """Take in the poses [robots, 3] of those `on_map`; others stay where they were seen last.

        Whoever is seen in a wall is put to its border, as in training: from within it no move would lead.
        """
        placed = pose[on_map]
        placed[:, :2] = self._walls.off(placed[:, :2])
        self._state.pose[0][on_map] = placed

    def decide(self, readings: Readings, stopped: Bools, decision: int, *, anew: bool) -> NDArray[np.float32]:
        """Decide from the poses that were placed and all else in `readings`; returns the observations.

        They are [1, robots, size]. Robots that are `stopped` [robots] stand still; `decision` is its number
        since the run began, by which a policy may draw; `anew` begins a run.
        """
        state = self._state
        take_in(state, readings)
        heading = state.pose[..., 2]
        # Those in range are taken as they are: folding rounds.
        outside = (heading < -np.pi) | (heading >= np.pi)
        heading[outside] = wrap_angle(heading[outside])
        if anew:
            self._driver.reset(state.pose)
            self._dec.reset(state, [])
        else:
            state.refused[...] = self._driver.held_back
            self._dec.update(self.actions[None], state)
        observation = self._dec.observe()
        chosen = np.asarray(self._act(observation, decision)[0], np.int64)
        self.actions = np.where(stopped, STOP, chosen)
        self.gripper = self._dec.gripper_commands()[0]
        self._driver.begin(state.pose, self.actions[None])
        return observation

    def stand(self) -> None:
        """Decide that all robots stand still: what was decided before is no longer meant."""
        self.actions = np.full(self.robots, STOP)
        self._driver.begin(self._state.pose, self.actions[None])

    def wheel_speeds(self, stopped: Bools) -> Floats:
        """Return wheel speeds [robots, 2] for the next control period, 0 for those `stopped` [robots]."""
        limit = self._limit
        speeds: Floats = np.clip(self._driver.wheel_speeds(self._state.pose)[0], -limit, limit)
        speeds[stopped] = 0.0
        return speeds
