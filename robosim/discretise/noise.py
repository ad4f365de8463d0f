"""Sensors that err: poses that are noisy, late, lost or coarse in time, and pheromones that are read badly.

What a robot feels on its own body (its pellet, the pellet at its gripper, touches, refused moves) stays
exact; poses come from outside, as from cameras over the arena, and pheromones from a map elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from robosim.arena.model import Arena, Zone
from robosim.discretise.reckoning import Reckoning
from robosim.discretise.sensing import ExactSensor, Percept, Sensor
from robosim.discretise.walls import Walls
from robosim.records import Record
from robosim.robot.kinematics import wrap_angle
from robosim.world.chance import Chance, child, normal, uniform
from robosim.world.contacts import ContactKind
from robosim.world.state import World, WorldState

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LONGEST_DELAY = 100
"""Decisions."""
_NORMAL, _UNIFORM, _READ_NORMAL, _READ_UNIFORM = range(4)
"""Keys of the seeds, children of an episode's for sensing."""


class SensingConfig(Record):
    """How robots learn of poses: their own, and through the map each other's."""

    position_noise: float = Field(default=0.0, ge=0.0, le=10.0)
    """Standard deviation of the error in x and in y, drawn anew for each fix, m."""
    heading_noise: float = Field(default=0.0, ge=0.0, le=10.0)
    """Standard deviation of the error in the heading, drawn anew for each fix, rad."""
    outliers: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a fix is far off."""
    outlier_size: float = Field(default=0.0, ge=0.0, le=100.0)
    """Standard deviation of what such a fix is off in x and in y besides, m."""
    dropout: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a fix gets lost; the robot goes on with the last one."""
    update_every: int = Field(default=1, ge=1, le=10_000)
    """Decisions from one fix to the next."""
    delay: int = Field(default=0, ge=0, le=LONGEST_DELAY)
    """Decisions from a fix being made to its arriving."""
    odometry: float | None = Field(default=None, gt=0, le=1)
    """Robots go on from their last fix by the turns of their wheels, and this is the weight of a new fix
    beside that; none for robots that go by fixes alone."""


class ReadingConfig(Record):
    """How robots read the pheromone map around them; every number by itself, delay and loss as a whole."""

    gain_noise: float = Field(default=0.0, ge=0.0, le=10.0)
    """Standard deviation of the factor, about 1, by which a number is off."""
    additive_noise: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of what a number is off besides; numbers run from 0 to 1 and are cut to that."""
    levels: int = Field(default=0, ge=0, le=65_536)
    """How many values a number can have, evenly from 0 to 1; 0 or 1 for all."""
    loss: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a robot's reading gets lost; the robot goes on with the last one."""
    delay: int = Field(default=0, ge=0, le=LONGEST_DELAY)
    """Decisions from a reading being made to its arriving."""


EXACT_SENSING, EXACT_READING = SensingConfig(), ReadingConfig()


class Arrivals:
    """The last that has arrived of something sent in every decision, for each robot by itself.

    The first is always there at once.
    """

    def __init__(self, delay: int) -> None:
        self._delay = delay
        self._sent: list[tuple[Floats, Bools]] = []
        self._last = np.empty(0)

    def take(self, sent: Floats, kept: Bools) -> Floats:
        """Send [envs, robots, ...], of which only what is `kept` [envs, robots] arrives; return the last."""
        if not self._last.size:
            self._last = sent
        self._sent.append((sent, kept))
        if len(self._sent) > self._delay:
            arrived, got = self._sent.pop(0)
            more = (1,) * (arrived.ndim - got.ndim)
            self._last = np.where(got.reshape(*got.shape, *more), arrived, self._last)
        return self._last


class NoisySensor:
    """Perceives poses as `SensingConfig` says, and all else as it is.

    No robot takes itself for standing in a wall: an estimate there is put to the nearest free cell, since
    robots know the map.
    """

    def __init__(
        self, config: SensingConfig, arena: Arena, num_envs: int, robots: int, travel: Floats | float = 0.0
    ) -> None:
        """`travel` (m) is the farthest that robots come in a decision: of use where they count turns."""
        self._config = config
        self._travel = travel
        self._reckoning: Reckoning | None = None
        self._shape = (num_envs, robots)
        self._exact = ExactSensor()
        self._walls = Walls(arena.zones != Zone.WALL, arena.cell_size)
        self._decision = 0
        self._arrivals, self._made = Arrivals(config.delay), Arrivals(config.delay)
        self.age = np.zeros(self._shape)
        self._errors: Chance
        self._odds: Chance

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        robots = self._shape[1]
        self._decision = 0
        self._arrivals, self._made = Arrivals(self._config.delay), Arrivals(self._config.delay)
        if self._config.odometry is not None:
            self._reckoning = Reckoning(self._config.odometry, self._travel, self._config.delay)
        self._errors = normal([child(seed, _NORMAL) for seed in seeds], (robots, 5))
        self._odds = uniform([child(seed, _UNIFORM) for seed in seeds], (robots, 2))

    def sense(self, state: WorldState) -> Percept:
        config = self._config
        odds = self._odds.next()
        fixed = self._fix(state.pose, self._errors.next(), odds[..., 0] < config.outliers)
        kept = odds[..., 1] >= config.dropout
        if self._decision % config.update_every:
            kept = np.zeros_like(kept)
        was = self.age
        self.age = self._decision - self._made.take(np.full(self._shape, float(self._decision)), kept)
        self._decision += 1
        pose = self._arrivals.take(fixed, kept)
        percept = self._exact.sense(state)
        if self._reckoning is not None:
            slips = percept.touched[ContactKind.ROBOT_ROBOT] | percept.touched[ContactKind.ROBOT_WALL]
            pose = self._reckoning.update(pose, self.age <= was, state.odometry, slips, self._config.delay)
            pose[..., :2] = self._walls.off(pose[..., :2])
        return percept._replace(pose=pose)

    def _fix(self, pose: Floats, errors: Floats, outlier: Bools) -> Floats:
        """Return the poses [envs, robots, 3] that are measured, in an array of their own."""
        config, measured = self._config, pose.copy()
        if config.position_noise or config.outliers:
            error = config.position_noise * errors[..., :2]
            error += (config.outlier_size * outlier)[..., None] * errors[..., 2:4]
            measured[..., :2] = self._walls.off(pose[..., :2] + error)
        if config.heading_noise:
            measured[..., 2] = wrap_angle(pose[..., 2] + config.heading_noise * errors[..., 4])
        return measured


def make_sensor(config: SensingConfig, world: World) -> Sensor:
    """Return the sensor of a configuration for the robots of `world`: the exact one where nothing errs."""
    if config.changed(odometry=None) == EXACT_SENSING:
        return ExactSensor()
    if config.odometry is not None:
        world.count_turns()
    return NoisySensor(config, world.arena, world.num_envs, world.robots, world.travel)


class Reader:
    """Makes of what is in the pheromone map what robots read of it, as `ReadingConfig` says."""

    def __init__(self, config: ReadingConfig) -> None:
        self._config = config
        self._seeds: Sequence[np.random.SeedSequence] = ()
        self._arrivals = Arrivals(config.delay)
        self._errors: Chance | None = None
        self._odds: Chance | None = None

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Begin an episode in every environment; what is random in it comes from its one of `seeds`."""
        self._seeds = seeds
        self._arrivals = Arrivals(self._config.delay)
        self._errors = self._odds = None

    def read(self, patches: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what is read of patches [envs, robots, size], once in a decision."""
        config = self._config
        numbers = patches.astype(np.float64)
        if config.gain_noise or config.additive_noise:
            if self._errors is None:
                seeds = [child(seed, _READ_NORMAL) for seed in self._seeds]
                self._errors = normal(seeds, (2, *patches.shape[1:]))
            errors = self._errors.next()
            numbers *= 1.0 + config.gain_noise * errors[:, 0]
            numbers += config.additive_noise * errors[:, 1]
            np.clip(numbers, 0.0, 1.0, out=numbers)
        if config.levels > 1:
            steps = config.levels - 1
            numbers = np.rint(numbers * steps) / steps
        kept = np.ones(patches.shape[:2], dtype=np.bool_)
        if config.loss:
            if self._odds is None:
                seeds = [child(seed, _READ_UNIFORM) for seed in self._seeds]
                self._odds = uniform(seeds, patches.shape[1:2])
            kept = self._odds.next() >= config.loss
        return self._arrivals.take(numbers, kept).astype(np.float32)
