"""A folder, of a report for one, written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from robosim.errors import InputError

LAST_FILE = "index.html"
"""Where a folder was there before, what is written gets its place file by file, this one last."""


def require_folder(folder: Path) -> None:
    """Raise InputError now, before long work, if a report cannot be written to `folder` later."""
    with contextlib.suppress(_NotNowError), whole_folder(folder):
        raise _NotNowError


@contextlib.contextmanager
def whole_folder(folder: Path, what: str = "report") -> Iterator[Path]:
    """Give a hidden folder to write to; what is in it gets its place when the block ends well.

    A new `folder` appears by one rename. One that is there, and empty, stays: it may be mounted, or the one a
    person stands in. InputError, about `what` it is to hold, if it cannot be written or is not empty; nothing
    is left behind then.
    """
    try:
        target = _resolved(folder)
        is_new = _is_new(folder, target, what)
        part = (target.parent if is_new else target) / f".{target.name}.{os.getpid()}.part"
        made = [above for above in part.parents if not above.exists()]
        try:
            part.mkdir(parents=True)
            yield part
            _move(part, target, is_new)
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            with contextlib.suppress(OSError):
                for above in made:
                    above.rmdir()
            raise
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{folder}: the {what} cannot be written: {reason}.") from None


class _NotNowError(Exception):
    """Ends the writing of a report before it begins."""


def _resolved(folder: Path) -> Path:
    try:
        return folder.resolve()
    except RuntimeError:  # Of Python before 3.13, for a link that leads to itself.
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP)) from None


def _is_new(folder: Path, target: Path, what: str) -> bool:
    if not target.exists():
        return True
    if not target.is_dir():
        raise InputError(f"{folder}: this is a file; a {what} needs a folder.")
    if any(target.iterdir()):
        raise InputError(f"{folder}: this folder is not empty; a {what} needs a new one.")
    return False


def _move(part: Path, target: Path, is_new: bool) -> None:
    """Move what was written to its place, the page last where that takes more than one step."""
    if is_new:
        part.rename(target)
        return
    names = sorted((path.name for path in part.iterdir()), key=lambda name: (name == LAST_FILE, name))
    moved: list[str] = []
    try:
        for name in names:
            if (target / name).exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
            (part / name).rename(target / name)
            moved.append(name)
        part.rmdir()
    except BaseException:
        for name in moved:
            (target / name).rename(part / name)
        raise
