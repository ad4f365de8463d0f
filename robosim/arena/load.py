"""Find arenas: those that ship, by name, and files of the user's own, by path."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from robosim.arena.model import Arena
from robosim.arena.parse import parse_arena
from robosim.arena.shipped import shipped_folder, shipped_names
from robosim.errors import InputError, nearest_names, printable
from robosim.errors import name_or_path as text_of
from robosim.texts import read_text

_MOST_BYTES = 1_000_000


def arena_names() -> list[str]:
    """Names of the arenas that ship, sorted."""
    return shipped_names("arenas")


def load_arena(name_or_path: str | Path) -> Arena:
    """Read and check an arena: a shipped one by name, any file by path, or the text of a file.

    What has more than one line is the text of a file.

    Raises InputError with one sentence per mistake, one on each line.
    """
    if isinstance(name_or_path, str) and "\n" in name_or_path:
        return _parsed(name_or_path, "arena")
    path = _find(name_or_path)
    return _parsed(_read(path), str(path))


@lru_cache(maxsize=64)
def _parsed(text: str, file: str) -> Arena:
    """Read an arena's text, or take the one that was read from it: arenas do not change."""
    return parse_arena(text, file)


def _find(name_or_path: str | Path) -> Path:
    text = text_of("arena", name_or_path)
    names = arena_names()
    if text in names:
        return shipped_folder("arenas") / f"{text}.toml"
    path = Path(text)
    if isinstance(name_or_path, str) and path.name == text and path.suffix != ".toml" and not _exists(path):
        raise InputError(f"No arena is named '{printable(text)}': {nearest_names(text, names)}")
    return path


def _exists(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _read(path: Path) -> str:
    return read_text(path, _MOST_BYTES, "arena file")
