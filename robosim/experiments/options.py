"""Options of runs whose team does not learn: it takes few, but a wrong one is a mistake all the same."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from robosim.arena import load_arena
from robosim.envs.config import with_profile
from robosim.errors import InputError, nearest_names, refused, shown
from robosim.experiments.team import start_weights
from robosim.learning.algorithms.protocol import AlgorithmConfig
from robosim.learning.algorithms.registry import algorithm_names, find_algorithm
from robosim.learning.config import RunConfig
from robosim.records import allowed, sentence

_PROFILE = "profile"
_ALGORITHM = "algorithm"


class OptionCheck:
    """Checks options one by one, since which of them go together depends on who learns; each value once."""

    def __init__(self) -> None:
        self._sound: set[tuple[str, str]] = set()

    def require(self, options: Mapping[str, Any]) -> None:
        """Raise InputError for what is an option of no algorithm's runs, and for a value that none takes."""
        _require_names(options)
        for name, value in options.items():
            if (name, repr(value)) not in self._sound:
                _require_value(name, value)
                self._sound.add((name, repr(value)))


def _require_names(names: Iterable[str]) -> None:
    known = {*RunConfig.options(), _PROFILE}
    strange = [name for name in names if name not in known]
    if strange:
        known.update(*(algorithm.model_fields for algorithm in _algorithms()))
    for name in strange:
        if name not in known:
            raise InputError(f"{shown(name)} is not an option: {nearest_names(name, known)}")


def _require_value(name: str, value: object) -> None:
    if name == _PROFILE:
        with_profile({name: value})
    elif name == _ALGORITHM:
        find_algorithm(str(value))
    elif name in (options := RunConfig.options()):
        _require_field(options[name].path, value)
        if name == "start_from" and value:
            start_weights(str(value))
        if name == "arenas":
            for arena in value if isinstance(value, list) else ():
                load_arena(arena)
    else:
        _require_of_algorithm(name, value)


def _require_field(path: Sequence[str], value: object) -> None:
    """Raise InputError for a value that a field of a run's configuration does not take."""
    table: Any = value
    for step in reversed(path):
        table = {step: table}
    try:
        RunConfig.model_validate(table)
    except ValidationError as error:
        # What is wrong with a record as a whole is about other fields, too.
        if error.errors()[0]["loc"][: len(path)] == tuple(path):
            raise InputError(sentence(RunConfig, error)) from None


def _require_of_algorithm(name: str, value: object) -> None:
    """Raise InputError unless there is an algorithm that takes a value in its field of that name."""
    said: dict[str, str] = {}
    for algorithm in _algorithms():
        if name not in algorithm.model_fields:
            continue
        try:
            algorithm.model_validate({name: value})
        except ValidationError as error:
            if error.errors()[0]["loc"]:
                takes = f"{allowed(algorithm.model_fields[name])} ({algorithm.model_fields['name'].default})"
                said.setdefault(sentence(algorithm, error), takes)
                continue
        return
    if len(said) == 1:
        raise InputError(f"algorithm: {next(iter(said))}")
    raise refused(f"algorithm: {name}", value, ", or ".join(said.values()))


def _algorithms() -> Iterable[type[AlgorithmConfig]]:
    # One at a time: to load them takes a while.
    return (find_algorithm(name) for name in algorithm_names())
