"""The log of a controller: what came in and what went out, a line of JSON for each control period.

Lines are written as they happen, so that what led to a crash can be read. Numbers are written so that they
are read back to the last bit: a controller that is given the logged readings again gives the same commands.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import NDArray

from robosim.deploy.readings import Readings
from robosim.envs.config import EnvConfig
from robosim.equality import EqualByValue
from robosim.errors import InputError

if TYPE_CHECKING:
    from robosim.deploy.controller import Command, Controller

FORMAT = "robosim-log"
FORMAT_VERSION = 1


class DecisionLog:
    """Writes a log, line by line.

    A disk that takes no more must not stop robots from being controlled: the log then ends, and `failed` says
    why.
    """

    def __init__(self, path: str | Path) -> None:
        """Begin a new file; InputError if it cannot be written, or is there already."""
        self.path = Path(path)
        self.failed = ""
        """Why the log has ended early; empty while it has not."""
        try:
            self._file: TextIO = self.path.open("x", encoding="utf-8", buffering=1)
        except FileExistsError:
            raise InputError(f"{path}: is there already; a log is never written over.") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror or error}.") from None

    def begin(self, policy: str, config: EnvConfig, max_age: float) -> None:
        """Write the first line: who drives, in what environment."""
        self._write(
            {
                "format": FORMAT,
                "version": FORMAT_VERSION,
                "policy": policy,
                "max_age": max_age,
                "env": config.model_dump(mode="json"),
            }
        )

    def add(
        self, period: int, readings: Readings, now: float, command: Command, emergency: str, observed: str
    ) -> None:
        """Write the line of a control period; `observed` is the SHA-256 of a decision's observations."""
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
        }
        if command.actions is not None:
            line |= {"actions": _listed(command.actions), "observation": observed}
        self._write(line)

    def close(self) -> None:
        """End the log."""
        self._file.close()

    def _write(self, line: dict[str, Any]) -> None:
        if self.failed:
            return
        try:
            self._file.write(json.dumps(line, allow_nan=False) + "\n")
        except (OSError, ValueError) as error:
            self.failed = f"{self.path}: the log ends early: {str(error).rstrip('.')}."


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
    emergency: str
    actions: NDArray[np.int64] | None
    """[robots]; None within a decision."""
    observation: str
    """SHA-256 of the observations of a decision, float32 [1, robots, size]; empty within one."""


def read_log(path: str | Path) -> Iterator[Logged]:
    """Yield the control periods of a log, without a last line that was cut short.

    InputError, with the number of the line, for what is no log.
    """
    source = Path(path)
    try:
        lines = source.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None
    for number, line in enumerate(lines[:-1], 1):
        try:
            table = json.loads(line)
            if number > 1:
                yield _logged(table)
                continue
            known = (table["format"], table["version"]) == (FORMAT, FORMAT_VERSION)
        except (ValueError, TypeError, KeyError):
            raise InputError(f"{path}: line {number} is not a line of a controller's log.") from None
        if not known:
            raise InputError(f"{path}: not a controller's log of version {FORMAT_VERSION}.")


def run_again(path: str | Path, controller: Controller) -> Iterator[tuple[Logged, Command]]:
    """Yield each logged control period with what a fresh `controller` commands on its readings.

    The two are equal to the bit if the controller is the one that was logged, with its policy and weights.
    """
    for logged in read_log(path):
        if logged.period == 0:
            controller.reset()
        if logged.emergency != controller.emergency:
            if controller.emergency:
                controller.resume()
            if logged.emergency:
                controller.emergency_stop(logged.emergency)
        yield logged, controller.step(logged.readings, logged.now)


def _logged(table: dict[str, Any]) -> Logged:
    actions = table.get("actions")
    return Logged(
        period=int(table["period"]),
        now=float(table["now"]),
        readings=Readings(
            time=_floats(table["time"]),
            pose=_floats(table["pose"]),
            laden=np.array(table["laden"], np.bool_),
            at_pellet=np.array(table["at_pellet"], np.bool_),
            touched=np.array(table["touched"], np.bool_),
            pellet=_floats(table["pellet"]),
        ),
        wheel_speeds=_floats(table["wheel_speeds"]),
        gripper=np.array(table["gripper"], np.int8),
        stopped=tuple(map(str, table["stopped"])),
        emergency=str(table["emergency"]),
        actions=None if actions is None else np.array(actions, np.int64),
        observation=str(table.get("observation", "")),
    )


def _listed(array: NDArray[np.generic]) -> Any:
    """Return an array as lists; numbers that are not finite, which JSON does not know, as None."""
    if array.dtype.kind != "f":
        return array.tolist()
    finite = np.isfinite(array)
    lists = array.astype(object)
    lists[~finite] = None
    return lists.tolist()


def _floats(lists: Any) -> NDArray[np.float64]:
    return np.array(lists, np.float64)
