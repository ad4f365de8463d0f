"""Find arenas: those that ship, by name, and files of the user's own, by path."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

from robosim.arena.model import Arena
from robosim.arena.parse import parse_arena
from robosim.arena.shipped import shipped_folder
from robosim.errors import InputError, nearest_names

_MOST_BYTES = 1_000_000


def arena_names() -> list[str]:
    """Names of the arenas that ship, sorted."""
    return sorted(path.stem for path in shipped_folder("arenas").glob("*.toml"))


def load_arena(name_or_path: str | Path) -> Arena:
    """Read and check an arena: a shipped one by name, any file by path, or the text of a file.

    What has more than one line is the text of a file.

    Raises InputError with one sentence per mistake, one on each line.
    """
    if isinstance(name_or_path, str) and "\n" in name_or_path:
        return _parsed(name_or_path)
    path = _find(name_or_path)
    return parse_arena(_read(path), str(path))


@lru_cache(maxsize=64)
def _parsed(text: str) -> Arena:
    """Read an arena's text, or take the one that was read from it: arenas do not change."""
    return parse_arena(text, "arena")


def _find(name_or_path: str | Path) -> Path:
    text = os.fspath(name_or_path)
    names = arena_names()
    if text in names:
        return shipped_folder("arenas") / f"{text}.toml"
    path = Path(text)
    if isinstance(name_or_path, str) and path.name == text and path.suffix != ".toml" and not _exists(path):
        raise InputError(f"No arena is named {text!r}: {nearest_names(text, names)}")
    return path


def _exists(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
    except IsADirectoryError:
        raise InputError(f"{path}: this is a directory; give the arena file (.toml) itself.") from None
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such arena file.") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"{path}: cannot be read: {reason}.") from None
    if len(data) > _MOST_BYTES:
        raise InputError(f"{path}: the file is larger than {_MOST_BYTES} bytes, the most an arena may have.")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8, as an arena file must be.") from None
