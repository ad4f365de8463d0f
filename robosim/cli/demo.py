"""`robosim demo`: train, evaluate, record; the whole house in a few minutes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Demo:
    """Train a small team, evaluate it against scripted ones, record a playback."""

    out: Path = Path("demo")
    """Folder for the trained run and the recording."""

    def run(self) -> None:
        raise NotImplementedError
