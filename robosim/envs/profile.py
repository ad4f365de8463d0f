"""Profiles: how far robots and what they perceive are from their data sheet, under a name.

What training randomises and what evaluation uses are profiles beside the arena, chosen by name or as a file.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pydantic import Field

from robosim.arena.shipped import shipped_folder, shipped_names
from robosim.discretise.noise import ReadingConfig, SensingConfig
from robosim.errors import InputError, nearest_names, printable
from robosim.errors import name_or_path as text_of
from robosim.records import Record
from robosim.texts import parse_toml, read_text
from robosim.world.motion import MotionConfig

LONGEST_PROFILE = 100_000
"""Bytes of a profile's file."""

CHANGED = ", changed"
"""Behind the name of a profile of which options have changed fields."""


class ProfileConfig(Record):
    """What episodes draw at random, and what robots perceive wrongly; by default nothing."""

    name: str = Field(default="", max_length=60)
    """For the reader: no code asks for it."""
    description: str = Field(default="", max_length=2000)
    """What it stands for, and where its numbers come from."""
    motion: MotionConfig = MotionConfig()
    """Wheels, motors, masses and friction, drawn anew in every episode, and late commands."""
    sensing: SensingConfig = SensingConfig()
    """How robots learn where they are."""
    pheromones: ReadingConfig = ReadingConfig()
    """How robots read the pheromone map."""

    @property
    def called(self) -> str:
        """Its name, for texts."""
        return self.name or "without a name"


def profile_names() -> list[str]:
    """Names of the profiles that ship, sorted."""
    return shipped_names("profiles")


def load_profile(name_or_path: str | Path) -> ProfileConfig:
    """Read and check a profile: a shipped one by name, any file by path, or the text of a file.

    What has more than one line is the text of a file. InputError in one sentence for whatever is wrong.
    """
    if isinstance(name_or_path, str) and "\n" in name_or_path:
        return _parsed(name_or_path, "profile")
    path = _find(name_or_path)
    return _parsed(_read(path), str(path))


def profile_text(name_or_path: str) -> str:
    """Return the name of a profile that ships, and the text of any other, which means the same anywhere."""
    if "\n" in name_or_path or name_or_path in profile_names():
        return name_or_path
    path = _find(name_or_path)
    text = _read(path)
    _parsed(text, str(path))
    return text + "\n"


@lru_cache(maxsize=16)
def _parsed(text: str, place: str) -> ProfileConfig:
    return ProfileConfig.from_table(parse_toml(text, place), place)


def _find(name_or_path: str | Path) -> Path:
    text = text_of("profile", name_or_path)
    names = profile_names()
    if text in names:
        return shipped_folder("profiles") / f"{text}.toml"
    path = Path(text)
    if isinstance(name_or_path, str) and path.name == text and path.suffix != ".toml":
        raise InputError(f"No profile is named '{printable(text)}': {nearest_names(text, names)}")
    return path


def _read(path: Path) -> str:
    return read_text(path, LONGEST_PROFILE, "profile")
