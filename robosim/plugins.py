"""Code of users that adds techniques, algorithms, rewards, controllers and metrics, wherever a command runs.

Modules register what they bring as they are imported. Which they are is said by the user's own environment:
the variable `ROBOSIM_PLUGINS`, or an installed package with an entry point in the group `robosim.plugins`.
No file that robosim reads names one.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from robosim.errors import InputError, printable, shown

VARIABLE = "ROBOSIM_PLUGINS"
"""Modules, or paths of their files, with commas between them."""
GROUP = "robosim.plugins"
"""Of entry points that name modules."""


@cache
def load_plugins() -> None:
    """Import the modules that the user's environment names, once; InputError for one that cannot be."""
    for name in _named():
        _load(name, f"{VARIABLE} names {shown(name)}")
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        _load(entry.module, f"the entry point {shown(entry.name)} of {GROUP} names {shown(entry.module)}")


def variable_elsewhere() -> dict[str, str]:
    """Return the variable, if it is set, as a process in another folder needs it: files by whole paths."""
    names = [str(Path(name).absolute()) if _is_file(name) else name for name in _named()]
    return {VARIABLE: ",".join(names)} if names else {}


def _named() -> list[str]:
    return list(filter(None, map(str.strip, os.environ.get(VARIABLE, "").split(","))))


def _is_file(name: str) -> bool:
    return name.endswith(".py")


def _load(name: str, who: str) -> None:
    try:
        if _is_file(name):
            _load_file(Path(name).absolute())
        else:
            importlib.import_module(name)
    except Exception as error:
        reason = printable(f"{type(error).__name__}: {error}", 300)
        raise InputError(f"{who}, which cannot be imported ({reason}).") from error


def _load_file(path: Path) -> None:
    """Import a file as the module of its name; what it registers is found by that name in other processes."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise FileNotFoundError(f"there is no file {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[path.stem]
        raise
