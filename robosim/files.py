"""Files written whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from robosim.errors import InputError


@contextlib.contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Give a hidden path beside `path` to write to, which takes its place when the block ends well.

    Raises InputError, in one sentence, if the file cannot be written; nothing is left behind then.
    """
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target}: cannot be written: it is a folder; give the name of a file.")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        try:
            yield part
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}.") from None


def write_whole(path: str | Path, data: bytes | str) -> None:
    """Write a file whole or not at all; raises InputError if it cannot be."""
    with whole_file(path) as part:
        part.write_bytes(data.encode() if isinstance(data, str) else data)


def require_writable(path: str | Path) -> None:
    """Raise InputError now, before long work, if a file cannot be written later."""
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target}: cannot be written: it is a folder; give the name of a file.")
    probe = target.with_name(f".{target.name}.{os.getpid()}.probe")
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}.") from None
