"""Robots of the simulated world that obey wheel speeds, to try a controller on before real ones."""

from __future__ import annotations

import numpy as np

from robosim.deploy.controller import Command
from robosim.deploy.readings import Readings
from robosim.envs.config import EnvConfig, env_config
from robosim.world.physics import PhysicsWorld
from robosim.world.state import LOOSE


class SimulatedRobots:
    """A team in the physical world: it is read as real robots are, and moves as a controller commands."""

    def __init__(self, config: EnvConfig, seed: int, episode: int = 0) -> None:
        """Begin the episode that a `VectorEnv` of one environment with this seed begins.

        InputError for more robots than the arena has room for.
        """
        config, self.arena = env_config(config)
        self.world = PhysicsWorld(self.arena, config.robots, 1, config.actions, config.pellet_gradient)
        self.world.reset([np.random.SeedSequence(seed, spawn_key=(episode,))])
        self._periods = 0

    @property
    def now(self) -> float:
        """Simulated time, s."""
        return self._periods * self.arena.timing.control_period

    def readings(self) -> Readings:
        """Return what the robots' sensors say, exactly and at once."""
        state = self.world.state
        pellet = np.full((self.world.robots, 2), np.nan)
        if state.pellets.size:
            nearest = state.nearest[0]
            loose = state.pellet_status[0, nearest] == LOOSE
            pellet[loose] = state.pellets[0, nearest[loose]]
        return Readings(
            time=np.full(self.world.robots, self.now),
            pose=state.pose[0].copy(),
            laden=state.held[0] >= 0,
            at_pellet=state.touching[0] >= 0,
            touched=state.touched[:, 0].copy(),
            pellet=pellet,
        )

    def obey(self, command: Command) -> None:
        """Hold the command's wheel speeds for a control period; grippers move at the end of a decision."""
        steps = self.arena.timing.control_steps
        if self._periods % steps == 0:
            self.world.begin_decision()
        self._periods += 1
        if self._periods % steps == 0:
            self.world.end_decision(command.wheel_speeds[None], command.gripper[None])
        else:
            self.world.drive(command.wheel_speeds[None])
