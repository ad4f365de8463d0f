"""A recording on disk: whole under its name, or not there at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from robosim.episodes.control_frame import LOG_SUFFIX
from robosim.episodes.trajectory import SUFFIX
from robosim.errors import InputError

APPLICATION = "robosim"
_LEAST_SPACE = 1_000_000
_PATIENCE = 10.0
"""How long a viewer may take for what it is still to be shown at the end, s."""


@contextlib.contextmanager
def recording_file(
    path: Path, blueprint: rrb.Blueprint, name: str, viewer: str = ""
) -> Iterator[rr.RecordingStream]:
    """Give a stream that becomes the recording `path` when the block ends without an exception.

    A viewer that listens at the URL `viewer` is shown it meanwhile; if that ends before, nothing is lost.
    Until then the bytes are in a hidden file beside it, which an exception removes. Raises InputError
    at once if nothing can be written there, and OSError at the end if the file did not become whole.
    """
    part = _reserve(path)
    # Without it rerun turns mistakes into warnings and leaves the data out.
    rr.set_strict_mode(True)
    finished = False
    try:
        require_space(part.parent, _LEAST_SPACE)
        with _stream_to(part, blueprint, viewer) as stream:
            stream.send_recording_name(name)
            yield stream
            finished = True
        _check_footer(part)
        part.replace(path)
    except (RuntimeError, ValueError) as error:
        if not finished:
            raise
        # rerun writes in a thread of its own and reports only here that it could not.
        raise OSError(0, "the recording could not be written whole; is the disk full?", str(path)) from error
    finally:
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def _stream_to(part: Path, blueprint: rrb.Blueprint, viewer: str) -> Iterator[rr.RecordingStream]:
    if not viewer:
        with rr.RecordingStream(APPLICATION) as stream:
            stream.save(part, default_blueprint=blueprint)
            yield stream
        return
    # Not as a context: its end raises, and leaves the file without one, where a viewer has been closed.
    stream = rr.RecordingStream(APPLICATION)
    stream.set_sinks(rr.FileSink(part), rr.GrpcSink(viewer), default_blueprint=blueprint)
    try:
        yield stream
    finally:
        with contextlib.suppress(RuntimeError):
            stream.flush(timeout_sec=_PATIENCE)
        stream.disconnect()


def require_recording(path: str | Path) -> None:
    """Raise InputError now, before long work, if a recording cannot be written there later."""
    _reserve(Path(path)).unlink()


def require_whole_recording(path: Path) -> None:
    """Raise InputError, in a sentence, if a file is no recording, or not the whole of one."""
    if not path.exists():
        raise InputError(f"{path}: there is no such recording.")
    if not path.is_file():
        raise InputError(f"{path}: this is no file, so it is no recording.")
    if path.suffix == SUFFIX:
        raise InputError(f"{path}: a trajectory is no recording; `robosim play` makes one of it.")
    if path.suffix == LOG_SUFFIX:
        raise InputError(f"{path}: a controller's log is no recording; `robosim play` makes one of it.")
    try:
        with warnings.catch_warnings():
            # That it has no footer; a file that was cut off has none, and then it is refused below.
            warnings.simplefilter("ignore")
            found = RrdReader(path).recordings()
    except (RuntimeError, ValueError, OSError) as error:
        reason = " ".join(str(error).rpartition(f"{path}: ")[2].split())
        raise InputError(f"{path}: is no recording, or not a whole one ({reason}).") from None
    if not found:
        raise InputError(f"{path}: holds no recording.")


def _reserve(path: Path) -> Path:
    if path.suffix != ".rrd":
        raise InputError(f"Recording {str(path)!r}: the file name must end in .rrd, the viewer's format.")
    if path.is_dir():
        raise InputError(f"Recording {str(path)!r}: this is a folder; give the name of a file in it.")
    part = path.with_name(f".{path.name}.{os.getpid()}-{time.time_ns()}.part")
    try:
        part.open("xb").close()
    except OSError as error:
        raise InputError(
            f"Recording {str(path)!r}: cannot be written ({error.strerror}); "
            "name a file in an existing folder that you may write to."
        ) from error
    return part


def require_space(folder: Path, size: int) -> None:
    """Raise OSError unless the disk of `folder` has room for `size` more bytes.

    To be asked before data is handed over: a full disk can make rerun 0.41 wait for ever.
    """
    free = shutil.disk_usage(folder).free
    if free < size:
        sentence = (
            f"the disk is full: the recording needs {size / 1e6:.0f} MB more, {free / 1e6:.0f} MB are free"
        )
        raise OSError(errno.ENOSPC, sentence, str(folder))


def _check_footer(part: Path) -> None:
    RrdReader(part).store().schema()
