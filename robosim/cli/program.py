"""How a person calls this robosim again: what hints print."""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path

_NAME = "robosim"


def hint(*words: str | Path) -> str:
    """Return a command of this robosim that works as printed, whether or not it is on the path."""
    return " ".join((_program(), *(shlex.quote(str(word)) for word in words)))


def _program() -> str:
    own = shutil.which(_NAME, path=str(Path(sys.executable).parent))
    if own is None:
        return f"{shlex.quote(sys.executable)} -m {_NAME}"
    found = shutil.which(_NAME)
    if found is not None and Path(found).samefile(own):
        return _NAME
    here, program = Path.cwd(), Path(own)
    return shlex.quote(str(program.relative_to(here) if program.is_relative_to(here) else program))
