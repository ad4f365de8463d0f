"""How real robots differ from their data sheet: wheels, motors, weight, ground, and late commands.

A `MotionConfig` says within which ranges; what an episode draws from them is a `MotionDraws`. Ranges, rather
than noise at every moment, since what differs from robot to robot stays with it (domain randomisation after
Tobin 2017 and Peng 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from robosim.equality import EqualByValue
from robosim.errors import refused
from robosim.records import Many, Record
from robosim.world.chance import child, uniform
from robosim.world.draws import Draws

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_Number = TypeVar("_Number", np.float64, np.int64)

PROFILE = 2
"""Key of the seed from which a profile draws, a child of the episode's: what a world draws by itself stays
the same. Sensors have the child before it."""
_DRAWS, _JITTER = 0, 1
LONGEST_LAG = 2.0
"""s."""
LONGEST_LATENCY = 5.0
"""s."""

_Two = Field(min_length=2, max_length=2)
Factors = Annotated[Many[Annotated[float, Field(ge=0.1, le=10.0)]], _Two]
Gains = Annotated[Many[Annotated[float, Field(ge=0.1, le=2.0)]], _Two]
Shares = Annotated[Many[Annotated[float, Field(ge=-1.0, le=1.0)]], _Two]
Lags = Annotated[Many[Annotated[float, Field(ge=0.0, le=LONGEST_LAG)]], _Two]
Latencies = Annotated[Many[Annotated[float, Field(ge=0.0, le=LONGEST_LATENCY)]], _Two]
_ONE = (1.0, 1.0)
_ZERO = (0.0, 0.0)


class MotionConfig(Record):
    """Ranges [low, high] from which each episode draws evenly: for each robot, or for all pellets alike."""

    wheel_gain: Gains = _ONE
    """What both wheels make of a commanded speed, as a factor; the top speed stays that of the data sheet."""
    wheel_mismatch: Shares = _ZERO
    """How much faster the right wheel turns than the left one at equal commands, as a share."""
    motor_lag: Lags = _ZERO
    """Time constant with which wheel speeds follow commands (first order), s."""
    traction: Factors = _ONE
    """Friction between wheels and ground, as a factor."""
    robot_mass: Factors = _ONE
    """Robots' mass, as a factor."""
    pellet_mass: Factors = _ONE
    """Pellets' mass, as a factor: one for all pellets of an episode."""
    pellet_friction: Factors = _ONE
    """Friction between pellets and ground, as a factor: one for all pellets of an episode."""
    latency: Latencies = _ZERO
    """Time from a command to the wheels, s: in whole physics steps, or whole decisions in the grid world."""
    jitter: float = Field(default=0.0, ge=0.0, le=LONGEST_LATENCY)
    """Further time that each command takes, drawn evenly up to this, s; a late one undoes no newer one."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, tuple) and value[0] > value[1]:
                raise ValueError(
                    f"{name} is [{value[0]:g}, {value[1]:g}], but the first must be at most the second"
                )
        return self

    @property
    def late(self) -> bool:
        """Whether commands take time."""
        return self.latency[1] > 0.0 or self.jitter > 0.0

    @property
    def gradual(self) -> bool:
        """Whether what wheels are commanded changes within a control period."""
        return self.late or self.motor_lag[1] > 0.0


EXACT = MotionConfig()
"""Robots as their data sheet says."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionDraws(EqualByValue):
    """What an episode draws from a `MotionConfig`."""

    wheel_gain: Floats
    """[robots, 2] factors of the left and the right wheel, mismatch included."""
    motor_lag: Floats
    """[robots] s."""
    traction: Floats
    """[robots] factors."""
    robot_mass: Floats
    """[robots] factors."""
    latency: Floats
    """[robots] s."""
    pellet_mass: float
    """Factor."""
    pellet_friction: float
    """Factor."""

    def table(self) -> dict[str, Any]:
        """Return plain numbers and lists by name, for files."""
        return {name: np.asarray(value).tolist() for name, value in asdict(self).items()}

    def of_robot(self, robot: int) -> dict[str, Any]:
        """Return what concerns one robot, as plain numbers by name."""
        return {
            name: value[robot] if isinstance(value, list) else value for name, value in self.table().items()
        }


def draw_motion(config: MotionConfig, robots: int, episode: np.random.SeedSequence) -> MotionDraws:
    """Draw what an episode of that seed has; no draw depends on the other ranges."""
    rng = np.random.default_rng(child(child(episode, PROFILE), _DRAWS))
    unit = rng.random((6, robots))
    pellets = rng.random(2)

    def within(bounds: tuple[float, ...], share: Floats) -> Floats:
        low, high = bounds
        return low + (high - low) * share

    half = 0.5 * within(config.wheel_mismatch, unit[1])
    sides = np.stack([1.0 - half, 1.0 + half], axis=-1)
    mass, friction = within(config.pellet_mass, pellets[:1]), within(config.pellet_friction, pellets[1:])
    return MotionDraws(
        wheel_gain=within(config.wheel_gain, unit[0])[:, None] * sides,
        motor_lag=within(config.motor_lag, unit[2]),
        traction=within(config.traction, unit[3]),
        robot_mass=within(config.robot_mass, unit[4]),
        latency=within(config.latency, unit[5]),
        pellet_mass=float(mass[0]),
        pellet_friction=float(friction[0]),
    )


def with_motion(draws: Draws, motion: MotionDraws) -> Draws:
    """Return an episode's draws with the factors of `motion` multiplied in."""
    return replace(
        draws,
        robot_mass=draws.robot_mass * motion.robot_mass,
        traction=draws.traction * motion.traction,
        pellet_mass=draws.pellet_mass * motion.pellet_mass,
        pellet_friction=draws.pellet_friction * motion.pellet_friction,
    )


class LateCommands:
    """Commands on their way to the robots: each robot follows the newest that has arrived.

    Time is counted in whole steps of a world: physics steps, or decisions.
    """

    def __init__(
        self,
        config: MotionConfig,
        draws: Sequence[MotionDraws],
        episodes: Sequence[np.random.SeedSequence],
        step: float,
        period: int,
        idle: NDArray[_Number],
    ) -> None:
        """`step` is in s, `period` the steps from one command to the next, `idle` [envs, robots, ...] what
        robots do before the first arrives.
        """
        self._per_step = 1.0 / step
        self._latency = np.stack([one.latency for one in draws])
        self._jitter = config.jitter
        seeds = [child(child(episode, PROFILE), _JITTER) for episode in episodes]
        self._chance = uniform(seeds, self._latency.shape[1:]) if config.jitter > 0.0 else None
        longest = (config.latency[1] + config.jitter) * self._per_step
        depth = int(np.ceil(longest / period)) + 2
        # Newest first; those of before the episode have all arrived.
        self._commands: NDArray[Any] = np.repeat(idle[None], depth, axis=0)
        self._arrival = np.full((depth, *self._latency.shape), -1, dtype=np.int64)

    def send(self, commands: NDArray[_Number], now: int) -> None:
        """Send commands [envs, robots, ...] at a time in steps since the episode began."""
        delay = self._latency
        if self._chance is not None:
            delay = delay + self._jitter * self._chance.next()
        arrival = now + np.rint(delay * self._per_step).astype(np.int64)
        self._commands = np.concatenate([commands[None], self._commands[:-1]])
        self._arrival = np.concatenate([arrival[None], self._arrival[:-1]])

    def received(self, now: int) -> NDArray[Any]:
        """Return the commands [envs, robots, ...] that robots follow at a time, in steps."""
        newest = (self._arrival <= now).argmax(axis=0)
        more = (1,) * (self._commands.ndim - 1 - newest.ndim)
        index = newest.reshape(1, *newest.shape, *more)
        return np.asarray(np.take_along_axis(self._commands, index, axis=0)[0])


def require_meaning_on_grid(config: MotionConfig) -> None:
    """Raise InputError for what only bodies on wheels have."""
    for name in (one for one in MotionConfig.model_fields if one not in ("latency", "jitter")):
        wanted = getattr(EXACT, name)
        if getattr(config, name) != wanted:
            allowed = f"{list(wanted)} in the grid world, whose robots have neither wheels nor weight"
            raise refused(f"motion.{name}", getattr(config, name), allowed)
