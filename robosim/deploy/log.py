"""The log of a controller: what came in and what went out, a line of JSON for each control period.

Lines are written as they happen, so that what led to a crash can be read. Numbers are written so that they
are read back to the last bit: a controller that is given the logged readings again gives the same commands.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from robosim.deploy.readings import Readings
from robosim.envs.config import EnvConfig
from robosim.equality import EqualByValue
from robosim.errors import InputError, printable, refused
from robosim.records import Many, Record
from robosim.robot.drivers import ACTION_NAMES
from robosim.texts import parse_json, read_lines

if TYPE_CHECKING:
    from robosim.deploy.controller import Command, Controller

FORMAT: Final = "robosim-log"
FORMAT_VERSION: Final = 1
LONGEST_REASON = 200
"""Characters of a reason that are read."""
_LONGEST_HEAD = 10_000_000
"""Bytes of the first line, with an arena of a million characters."""
_LONGEST_LINE = 2_000_000
"""Bytes of a line; a robot takes some 300."""


class DecisionLog:
    """Writes a log, line by line.

    A disk that takes no more must not stop robots from being controlled: the log then ends, and `failed` says
    why.
    """

    def __init__(self, path: str | Path, robot: int | None = None) -> None:
        """Begin a new file; InputError if it cannot be written, or is there already.

        `robot` is the one that obeys, where each has a controller of its own.
        """
        self.path = Path(path)
        self._robot = robot
        self._begun = False
        self.failed = ""
        """Why the log has ended early; empty while it has not."""
        try:
            self._file: TextIO = self.path.open("x", encoding="utf-8", buffering=1)
        except FileExistsError:
            raise InputError(f"{path}: is there already; a log is never written over.") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror or error}.") from None

    def begin(self, policy: str, config: EnvConfig, max_age: float, *, shared_map: bool = False) -> None:
        """Write the first line: who drives, in what environment, and whether its pheromone map is shared."""
        head = LogHead(
            policy=printable(policy, LONGEST_REASON),
            max_age=max_age,
            robot=self._robot,
            map="shared" if shared_map else "own",
            env=config,
        )
        self._write(head.model_dump(mode="json"))

    def add(
        self,
        period: int,
        readings: Readings,
        now: float,
        command: Command,
        emergency: str,
        observed: str,
        *,
        begins: bool,
        resumed: bool,
    ) -> None:
        """Write the line of a control period; `observed` is the SHA-256 of a decision's observations.

        `begins` says that the controller is new, or was reset since the line before, and `resumed` that an
        emergency stop was ended since then.
        """
        self._begun = True
        line: dict[str, Any] = {
            "period": period,
            "now": now,
            "time": _listed(readings.time),
            "pose": _listed(readings.pose),
            "laden": _listed(readings.laden),
            "at_pellet": _listed(readings.at_pellet),
            "touched": _listed(readings.touched),
            "pellet": _listed(readings.pellet),
            "wheel_speeds": _listed(command.wheel_speeds),
            "gripper": _listed(command.gripper),
            "stopped": list(command.stopped),
            "unstopped": _listed(command.unstopped),
            "emergency": emergency,
            "begins": begins,
            "resumed": resumed,
        }
        if command.actions is not None:
            line |= {"actions": _listed(command.actions), "observation": observed}
        self._write(line)

    def close(self) -> None:
        """End the log; one without any control period goes, not to be in the path of the next start."""
        try:
            self._file.close()
            if not self._begun:
                self.path.unlink(missing_ok=True)
        except OSError as error:
            self.failed = self.failed or f"{self.path}: the log ends early: {error.strerror or error}."

    def _write(self, line: dict[str, Any]) -> None:
        if self.failed:
            return
        try:
            self._file.write(json.dumps(line, allow_nan=False) + "\n")
        except (OSError, ValueError) as error:
            self.failed = f"{self.path}: the log ends early: {str(error).rstrip('.')}."


class LogHead(Record):
    """The first line of a log."""

    format: Literal["robosim-log"] = FORMAT
    version: Literal[1] = FORMAT_VERSION
    policy: str = Field(max_length=LONGEST_REASON)
    """What the controller was told that the policy is called."""
    max_age: float = Field(gt=0)
    """s."""
    robot: int | None = Field(default=None, ge=0, lt=1000)
    """Which robot of the team obeys; None for all."""
    map: Literal["own", "shared"] = "own"
    """Whether the pheromone map was the controller's own, or one that is kept elsewhere for all."""
    env: EnvConfig
    """Arena, team, pheromones and all else that the controller was made of."""


_Number = float | None
_Flags = Many[bool]


class _Line(Record):
    """A further line of a log, as it stands there."""

    period: int = Field(ge=0, le=10**15)
    now: float
    time: Many[_Number]
    pose: Many[Many[_Number]]
    laden: _Flags
    at_pellet: _Flags
    touched: Many[_Flags]
    pellet: Many[Many[_Number]]
    wheel_speeds: Many[Many[float]]
    gripper: Many[Literal[-1, 0, 1]]
    stopped: Many[str]
    unstopped: _Flags
    emergency: str
    begins: bool
    resumed: bool
    actions: Many[int] | None = None
    observation: str = Field(default="", max_length=64)


@dataclass(frozen=True, slots=True, eq=False)
class Logged(EqualByValue):
    """A control period of a log."""

    period: int
    """Since the controller began, or was reset, from 0."""
    now: float
    readings: Readings
    wheel_speeds: NDArray[np.float64]
    """[robots, 2]."""
    gripper: NDArray[np.int8]
    """[robots]."""
    stopped: tuple[str, ...]
    """[robots]."""
    unstopped: NDArray[np.bool_]
    """[robots] an emergency stop could not be seen to hold this robot."""
    emergency: str
    begins: bool
    """A run begins with it: the controller was new, or had been reset."""
    resumed: bool
    """An emergency stop was ended since the period before."""
    actions: NDArray[np.int64] | None
    """[robots]; None within a decision."""
    observation: str
    """SHA-256 of the observations of a decision, float32 [1, robots, size]; empty within one."""


_OF_READINGS = ("time", "pose", "laden", "at_pellet", "touched", "pellet")
_ARRAYS: dict[str, tuple[Any, tuple[int, ...], tuple[int, ...]]] = {
    "time": (np.float64, (), ()),
    "pose": (np.float64, (), (3,)),
    "laden": (np.bool_, (), ()),
    "at_pellet": (np.bool_, (), ()),
    "touched": (np.bool_, (3,), ()),
    "pellet": (np.float64, (), (2,)),
    "wheel_speeds": (np.float64, (), (2,)),
    "gripper": (np.int8, (), ()),
    "unstopped": (np.bool_, (), ()),
}
"""Type, and dimensions before and after that of the robots, of what a line holds of all robots."""


class Log(NamedTuple):
    """A log that is being read."""

    head: LogHead
    periods: Iterator[Logged]
    """Read as they are asked for; InputError, with the number of the line, for what is none."""


def open_log(path: str | Path) -> Log:
    """Begin to read a log; a last line that was cut short is left out. InputError for what is no log."""
    lines = read_lines(Path(path), _LONGEST_HEAD, "log")
    first = next(lines, None)
    if first is None:
        raise InputError(f"{path}: holds no whole line, so it is no controller's log.")
    table = _table(path, 1, first)
    if table.get("format") != FORMAT or table.get("version") != FORMAT_VERSION:
        raise InputError(f"{path}: not a controller's log of version {FORMAT_VERSION}.")
    head = LogHead.from_table(table, f"{path}: line 1")
    return Log(head, _periods(path, head, lines))


def read_log(path: str | Path) -> Iterator[Logged]:
    """Yield the control periods of a log, as `open_log` reads them."""
    yield from open_log(path).periods


def _periods(path: str | Path, head: LogHead, lines: Iterator[bytes]) -> Iterator[Logged]:
    for number, line in enumerate(lines, 2):
        place = f"{path}: line {number}"
        if len(line) > _LONGEST_LINE:
            raise InputError(f"{place} is longer than {_LONGEST_LINE} bytes, the most it may have.")
        yield _logged(_Line.from_table(_table(path, number, line), place), head, place)


def _table(path: str | Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        table = parse_json(line)
    except ValueError:
        table = None
    if not isinstance(table, dict):
        raise InputError(f"{path}: line {number} is not a line of a controller's log.")
    return table


def run_again(path: str | Path, controller: Controller) -> Iterator[tuple[Logged, Command]]:
    """Yield each logged control period with what a fresh `controller` commands on its readings.

    The two are equal to the bit if the controller is the one that was logged, with its policy and weights.
    InputError for a log of a robot whose pheromone map was kept elsewhere: what it read is not in the log.
    """
    log = open_log(path)
    if log.head.map == "shared":
        raise InputError(
            f"{path}: its pheromone map was kept elsewhere, so the run cannot be commanded again."
        )
    for logged in log.periods:
        if logged.begins:
            controller.reset()
        if logged.resumed:
            controller.resume()
        if logged.emergency and logged.emergency != controller.emergency:
            controller.emergency_stop(logged.emergency)
        yield logged, controller.step(logged.readings, logged.now, logged.period)


def _logged(line: _Line, head: LogHead, place: str) -> Logged:
    robots = head.env.robots
    arrays = {
        name: _array(getattr(line, name), dtype, (*outer, robots, *inner), f"{place}: {name}")
        for name, (dtype, outer, inner) in _ARRAYS.items()
    }
    if len(line.stopped) != robots:
        raise refused(f"{place}: stopped", list(line.stopped), f"a list of {robots} texts")
    actions = None
    if line.actions is not None:
        actions = _array(line.actions, np.int64, (robots,), f"{place}: actions")
        most = len(ACTION_NAMES[head.env.actions]) - 1
        if actions.min() < 0 or actions.max() > most:
            raise refused(f"{place}: actions", list(line.actions), f"whole numbers from 0 to {most}")
    return Logged(
        period=line.period,
        now=line.now,
        readings=Readings(**{name: arrays[name] for name in _OF_READINGS}),
        wheel_speeds=arrays["wheel_speeds"],
        gripper=arrays["gripper"],
        stopped=tuple(printable(reason, LONGEST_REASON) for reason in line.stopped),
        unstopped=arrays["unstopped"],
        emergency=printable(line.emergency, LONGEST_REASON),
        begins=line.begins,
        resumed=line.resumed,
        actions=actions,
        observation=line.observation,
    )


def _array(value: Any, dtype: Any, shape: tuple[int, ...], place: str) -> NDArray[Any]:
    try:
        array = np.array(value, dtype)
    except (ValueError, OverflowError):
        array = np.empty(0, dtype)
    if array.shape != shape:
        raise refused(place, value, f"numbers in the shape {list(shape)}")
    return array


def _listed(array: NDArray[np.generic]) -> Any:
    """Return an array as lists; numbers that are not finite, which JSON does not know, as None."""
    if array.dtype.kind != "f":
        return array.tolist()
    finite = np.isfinite(array)
    lists = array.astype(object)
    lists[~finite] = None
    return lists.tolist()
