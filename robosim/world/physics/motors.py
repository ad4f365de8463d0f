"""Between the commanded speeds of wheels and those they have: gains, lag, and commands that come late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Timing
from robosim.robot.team import Team, per_wheel
from robosim.world.motion import LateCommands, MotionConfig, MotionDraws

Floats = NDArray[np.float64]


class Motors:
    """What the wheels of all robots go for in an episode; the limits of the data sheet come after it."""

    def __init__(
        self,
        config: MotionConfig,
        draws: Sequence[MotionDraws],
        episodes: Sequence[np.random.SeedSequence],
        team: Team,
        timing: Timing,
    ) -> None:
        self.gradual = config.gradual
        """Whether wheel speeds change in every substep, rather than once in a control period."""
        self.max_change = per_wheel(team.sheet.max_wheel_acceleration * timing.substep)
        """Of a wheel's speed in a substep, rad/s."""
        self.half_substep = np.array(0.5 * timing.substep)
        """s."""
        self._gain = np.stack([one.wheel_gain for one in draws])
        lag = np.stack([one.motor_lag for one in draws])[..., None]
        # First order, exact for a command that holds; without a lag all of the difference at once.
        with np.errstate(divide="ignore", over="ignore"):
            self._share = 1.0 - np.exp(-timing.substep / lag)
        self._substep = 0
        self._late = LateCommands(
            config, draws, episodes, timing.substep, timing.substeps, np.zeros(self._gain.shape)
        )

    def geared(self, wheel_speeds: Floats) -> Floats:
        """Return what the wheels make of commands [envs, robots, 2], rad/s."""
        return wheel_speeds * self._gain

    def send(self, wheel_speeds: Floats) -> None:
        """Send the commands of a control period, as it begins."""
        self._late.send(wheel_speeds, self._substep)

    def wanted(self, wheel_speeds: Floats) -> Floats:
        """Return the speeds that the motors go for in the next substep, from the present ones."""
        commands = self._late.received(self._substep)
        self._substep += 1
        return wheel_speeds + self._share * (commands - wheel_speeds)
