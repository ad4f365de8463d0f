"""Results: a line of JSON for each finished job, in one file that is small enough to keep with the code."""

from __future__ import annotations

import json
import math
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import robosim
from robosim.errors import InputError, printable, shown
from robosim.files import append_line
from robosim.texts import parse_json, read_text

_TEXT = re.compile(r'"(?:[^"\\]|\\.)*(?:"|$)')
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

    A line that a kill cut short counts for nothing. InputError for any other line that is no result.
    """
    try:
        lines = read_text(path, _MOST_BYTES, "results file").splitlines() if path.exists() else []
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None
    results: dict[str, Result] = {}
    for number, line in enumerate(lines, 1):
        try:
            table = parse_json(line)
            if not isinstance(table, dict):
                raise TypeError("it is no table")
            result = _result(**table)
            results[result.key] = result
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            if isinstance(error, json.JSONDecodeError) and _is_cut(line):
                continue
            reason = printable(str(error), 200)
            raise InputError(f"{path}: line {number} is no result ({reason}).") from None
    return results


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
    return result


def _numbers(rows: Mapping[str, Sequence[float]]) -> dict[str, tuple[float, ...]]:
    numbers = {name: tuple(map(float, values)) for name, values in rows.items()}
    if odd := [name for name, values in numbers.items() if not all(map(math.isfinite, values))]:
        raise ValueError(f"{odd[0]} has a number that is not finite")
    return numbers


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
