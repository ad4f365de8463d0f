"""Files written whole or not at all, and what a killed process leaves of them."""

from __future__ import annotations

import contextlib
import hashlib
import lzma
import os
import re
import stat
import struct
import time
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from robosim.errors import InputError, shown

_STRAY = re.compile(r"\.(?P<name>.+)\.\d+(-\d+)?\.(part|probe)")
"""`.NAME.PROCESS.part`, as `whole_file` calls what it writes; some put a time behind the process."""

ARCHIVE_DAMAGE = (
    ValueError,
    TypeError,
    SyntaxError,
    EOFError,
    LookupError,
    ArithmeticError,
    RuntimeError,
    MemoryError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)
"""What zipfile and numpy raise for an .npz file that is damaged, encrypted, or lies about its size."""

_MOST_BYTES = 4_000_000_000
"""Of a file of a run."""

_LOOK_AGAIN = 0.1
"""Time between two looks at a lock that another process holds, s."""


@contextlib.contextmanager
def whole_file(path: str | Path, durable: bool = False) -> Iterator[Path]:
    """Give a hidden path beside `path` to write to, which takes its place when the block ends well.

    A link is followed, and stays. `durable` waits until the file is on the disk, so that a power cut cannot
    leave its name with nothing behind it. Raises InputError, in one sentence, if the file cannot be written,
    or if something other than a regular file is there; nothing is left behind then.
    """
    target = _target(path)
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        # What an earlier process of the same number left may be a link, which must not be written through.
        part.unlink(missing_ok=True)
        try:
            yield part
            if durable:
                sync(part)
            part.replace(target)
            if durable:
                sync(target.parent)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise _cannot_be_written(path, error) from None


def write_whole(path: str | Path, data: bytes | str, durable: bool = False) -> None:
    """Write a file whole or not at all; errors and `durable` as in `whole_file`."""
    with whole_file(path, durable) as part:
        part.write_bytes(data.encode() if isinstance(data, str) else data)


def append_line(path: str | Path, line: str) -> None:
    """Append a line in one piece, whoever else appends at the same time, and wait until it is on the disk.

    What a killed process left of a line is ended first: it stays a line of its own. InputError if the file
    cannot be written.
    """
    # Here, since there is none on Windows, where the rest of this module works.
    import fcntl

    target = _target(path)
    try:
        handle = os.open(target, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            # Goes with the handle. Without it, the end of the file may be that of a line half written.
            fcntl.flock(handle, fcntl.LOCK_EX)
            size = os.fstat(handle).st_size
            whole = size == 0 or os.pread(handle, 1, size - 1) == b"\n"
            data = (line if whole else f"\n{line}").encode() + b"\n"
            if os.write(handle, data) < len(data):
                raise OSError(0, "the line did not fit")
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        raise _cannot_be_written(path, error) from None


def require_writable(path: str | Path) -> None:
    """Raise InputError now, before long work, if a file cannot be written later."""
    target = _target(path)
    probe = target.with_name(f".{target.name}.{os.getpid()}.probe")
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise _cannot_be_written(path, error) from None


def real_path(path: Path) -> Path:
    """Return the path without links, of a file that need not be there; links that lead in a circle stay."""
    # Path.resolve raises an error of its own for these, another one in each version of Python.
    return Path(os.path.realpath(path))


def require_apart(
    outputs: Mapping[str, Path | None], inputs: Iterable[Path], folder: Path | None = None
) -> None:
    """Raise InputError where one output would replace another, lie in the new `folder`, or replace an input.

    `outputs` are files by the option that names each.
    """
    given = {option: path for option, path in outputs.items() if path is not None}
    for option, path in given.items():
        target = real_path(path)
        for other in given:
            if other != option and real_path(given[other]) == target:
                raise InputError(
                    f"{option} and {other} are both {path}, but must be two places: one would replace "
                    "the other."
                )
        for one in inputs:
            source = real_path(one)
            if target == source or (target.exists() and source in target.parents):
                raise InputError(f"{option} is {path}, but must be another file than those that are read.")
        if folder is not None and real_path(folder) in target.parents:
            raise InputError(f"{option} is {path}, but must not lie in the new folder {folder}.")


@contextlib.contextmanager
def alone_in(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """Hold a folder for this process; the system lets go of it when the process ends, however it ends.

    InputError when another process holds it, and still does after `patience` (s). Where the system has no
    such locks, nothing is held.
    """
    try:
        import fcntl
    except ImportError:  # On Windows.
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        deadline = time.monotonic() + patience
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() >= deadline:
                    raise InputError(f"{folder}: another process is at work in this folder.") from None
                time.sleep(_LOOK_AGAIN)
                continue
            except OSError:
                pass  # Some file systems of networks have no locks; work must be possible there, too.
            break
        yield
    finally:
        os.close(handle)


def is_regular(path: Path) -> bool:
    """Return whether a regular file is there itself: a link is none, wherever it leads."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def remove_strays(folder: Path, written: Callable[[str], bool]) -> None:
    """Remove what killed processes have left in `folder` of files for whose names `written` holds.

    Only regular files that are named as `whole_file` names them; everything else is left alone.
    """
    for path in sorted(folder.iterdir()):
        named = _STRAY.fullmatch(path.name)
        if named and written(named["name"]) and is_regular(path):
            path.unlink(missing_ok=True)


def digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of each of the files in `folder` that is there, by name."""
    return {name: _digest(folder / name) for name in names if is_regular(folder / name)}


def require_unchanged(folder: Path, known: Mapping[str, str]) -> None:
    """Raise InputError if a file in `folder` is not what it was, by digests of `digests`.

    Files that are gone are left to whoever needs them.
    """
    for name, digest in known.items():
        if ".." in Path(name).parts or Path(name).is_absolute():
            raise InputError(f"{folder}: {shown(name)} is not the name of a file of a run.")
        path = folder / name
        try:
            if is_regular(path) and _digest(path) != digest:
                raise InputError(f"{path}: is not what the run wrote: its SHA-256 is another.")
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size > _MOST_BYTES:
            raise InputError(f"{path}: the file is larger than {_MOST_BYTES} bytes, the most it may have.")
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _target(path: str | Path) -> Path:
    """Return where a file will lie, behind all links; InputError if anything but a regular file is there."""
    target = Path(path)
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return Path(os.path.realpath(target)) if target.is_symlink() else target
    except OSError as error:
        raise _cannot_be_written(path, error) from None
    if stat.S_ISDIR(mode):
        raise InputError(f"{path}: cannot be written: it is a folder; give the name of a file.")
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: cannot be written: it is not a regular file.")
    return Path(os.path.realpath(target)) if target.is_symlink() else target


def _cannot_be_written(path: str | Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written: {error.strerror or error}.")
