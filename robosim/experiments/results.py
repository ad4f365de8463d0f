"""Results: a line of JSON for each finished job, in one file that is small enough to keep with the code."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import robosim
from robosim.errors import InputError, printable, shown
from robosim.experiments.keys import key_of
from robosim.files import append_line
from robosim.texts import parse_json, read_text

_TEXT = re.compile(r'"(?:[^"\\]|\\.)*(?:"|$)')
_BEGIN = re.compile(r'\{\s*"key"\s*:\s*"[0-9a-f]{64}"')
"""How a record begins."""
_MOST_PARTS = 100
"""Records, whole or cut, in one line."""
_MOST_BYTES = 1_000_000_000
"""Of a file of results."""
_WHOLE = 10**15
"""From here on, floats do not hold every whole number."""
_PACKAGES = ("numpy", "pymunk", "torch")


@dataclass(frozen=True, slots=True)
class Result:
    """The record of a finished job."""

    key: str
    """Of the job."""
    config: Mapping[str, Any]
    figures: Mapping[str, Sequence[float]]
    """By name, one number for each episode."""
    wall_time: float
    """Time spent learning, s."""
    machine: Mapping[str, str]
    """Where it ran, as `this_machine` says it."""
    series: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """By name, numbers of which there are not as many as episodes."""
    evaluation_time: float = 0.0
    """Time spent on the evaluation, s."""


def append_result(path: Path, result: Result) -> None:
    """Append a result to a file, as one line and in one piece; InputError if it cannot be written."""
    table = asdict(result)
    for rows in ("figures", "series"):
        table[rows] = {name: [_short(value) for value in row] for name, row in table[rows].items()}
    append_line(path, json.dumps(table, allow_nan=False, separators=(",", ":")))


def _short(number: float) -> float | int:
    """Return a whole number as one: it takes less room in a file."""
    return int(number) if number.is_integer() and abs(number) < _WHOLE else number


def read_results(path: Path) -> dict[str, Result]:
    """Return the results in a file by key, the latest of each; none if there is no file.

    A record that a kill cut short counts for nothing, and neither do blank lines. InputError for any other
    line that is no result, and for a record whose configuration is not that of its key.
    """
    return ResultsFile(path).read()


class ResultsFile:
    """A file of results that is read on while several processes append to it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: dict[str, Result] = {}
        self._end = self._lines = 0
        """Characters and whole lines that have been read."""

    def read(self) -> dict[str, Result]:
        """Return the results as `read_results` does; only lines that are new since the last call are read."""
        try:
            there = self._path.exists()
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read: {error.strerror or error}.") from None
        text = read_text(self._path, _MOST_BYTES, "results file") if there else ""
        if len(text) < self._end:
            # Another file has taken its place.
            self._found, self._end, self._lines = {}, 0, 0
        lines = text[self._end :].split("\n")
        for number, line in enumerate(lines, self._lines + 1):
            self._take(line, number)
        # The last one has no end yet, and may go on.
        self._end, self._lines = len(text) - len(lines[-1]), self._lines + len(lines) - 1
        return dict(self._found)

    def _take(self, line: str, number: int) -> None:
        try:
            for table in _tables(line):
                if not isinstance(table, dict):
                    raise TypeError("it is no table")
                result = _result(**table)
                self._found[result.key] = result
        except (TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
            reason = printable(str(error), 200).rstrip(".")
            raise InputError(f"{self._path}: line {number} is no result ({reason}).") from None


def _tables(line: str) -> Iterator[Any]:
    """Yield what a line holds: one table as a rule, none if it is blank or cut short by a kill.

    Where files are put together and one ends in a line that a kill cut short, the next one's first record
    stands behind what is left of it.
    """
    rest = line.strip()
    for _ in range(_MOST_PARTS):
        if not rest:
            return
        try:
            yield parse_json(rest)
            return
        except json.JSONDecodeError as error:
            if error.msg == "Extra data" and _BEGIN.match(rest, error.pos):
                # Only the end of its line was missing.
                end = error.pos
                yield parse_json(rest[:end])
            else:
                following = _BEGIN.search(rest, 1)
                end = following.start() if following else len(rest)
                if not _is_cut(rest[:end]):
                    raise
        rest = rest[end:]
    raise ValueError(f"it holds more than {_MOST_PARTS} records")


def _is_cut(line: str) -> bool:
    """Return whether a table that begins in a line does not end in it."""
    outside = _TEXT.sub("", line)
    return outside.count("{") > outside.count("}")


def _result(
    figures: Mapping[str, Sequence[float]],
    series: Mapping[str, Sequence[float]] = MappingProxyType({}),
    **fields: Any,
) -> Result:
    result = Result(figures=_numbers(figures), series=_numbers(series), **fields)
    kinds: dict[str, Any] = {"key": str, "config": Mapping, "machine": Mapping, "wall_time": (int, float)}
    for name, kind in (kinds | {"evaluation_time": (int, float)}).items():
        if not isinstance(getattr(result, name), kind):
            raise TypeError(f"{name} is {shown(getattr(result, name))}")
    if result.key != key_of(result.config):
        raise ValueError("its key is not the SHA-256 of its config, so one of them is damaged")
    return result


def _numbers(rows: Mapping[str, Sequence[float]]) -> dict[str, tuple[float, ...]]:
    for name, values in rows.items():
        if not isinstance(values, list | tuple):
            raise TypeError(f"{name} is {shown(values)}, but must be a list of numbers")
        for value in values:
            # NaN is in no range.
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _WHOLE:
                raise ValueError(
                    f"{name} holds {shown(value)}, but must hold finite numbers up to {_WHOLE:g}"
                )
    return {name: tuple(map(float, values)) for name, values in rows.items()}


@cache
def this_machine() -> dict[str, str]:
    """Return on what this process runs: processor, platform, and versions of what numbers depend on."""
    versions = {"robosim": robosim.__version__}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "none"
    return {
        "processor": _processor(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        **versions,
    }


def _processor() -> str:
    """Return the processor's name; those of virtual machines say little, so family and model too."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    facts = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    if "model name" not in facts:
        return platform.processor() or platform.machine()
    return f"{facts['model name']} (family {facts.get('cpu family', '?')}, model {facts.get('model', '?')})"
