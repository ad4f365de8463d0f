"""Takes the place of pydantic, and of records, in an exported folder.

What a folder holds was checked when it was exported, so that nothing is checked here: records hold what they
are given, and defaults for the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

_Method = TypeVar("_Method")

Many = tuple[Any, ...]
Self = Any
"""Python 3.10, which the laboratory's list of packages is made for, has none in `typing`."""
_MISSING = object()


def Field(default: Any = _MISSING, **_: Any) -> Any:  # noqa: N802  as pydantic calls it
    """Return the default of a field."""
    return default


def model_validator(**_: Any) -> Callable[[_Method], _Method]:
    """Return a decorator that leaves a check as it is: nobody calls it."""
    return lambda method: method


class Record:
    """A record by its fields; TypeError for one that is unknown or missing."""

    def __init__(self, **values: Any) -> None:
        names = [name for name, kind in type(self).__annotations__.items() if "ClassVar" not in kind]
        if unknown := values.keys() - names:
            raise TypeError(f"{type(self).__name__} has no field {min(unknown)!r}")
        for name in names:
            value = values.get(name, getattr(type(self), name, _MISSING))
            if value is _MISSING:
                raise TypeError(f"{type(self).__name__} needs {name!r}")
            setattr(self, name, value)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]  # fields may be changed
