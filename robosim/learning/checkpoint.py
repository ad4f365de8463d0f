"""Checkpoints: everything that a run goes on from, written whole, so that a kill at any moment costs little.

A checkpoint is one file, `NNNNNNNNNNNN.safetensors`, with tensors and, as JSON in its header, all else.
Experience is kept beside it in parts, each written once and shared by the checkpoints after it. Reading
runs no code from any of them.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import safetensors
import safetensors.torch
from torch import Tensor

from robosim.errors import InputError
from robosim.files import whole_file

FORMAT = "robosim-checkpoint-1"
_KEPT = 2
"""Checkpoints kept: the latest, and the one before for the case that the latest is damaged."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A moment of a run."""

    step: int
    """Joint decisions of the run so far."""
    tensors: Mapping[str, Tensor]
    facts: Mapping[str, Any]
    """What is no tensor, as JSON."""
    parts: tuple[str, ...]
    """Names of the files of experience that belong to it, oldest first."""


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint whole or not at all, then remove those that are no longer needed.

    InputError, and the checkpoints before left as they are, when it cannot be written.
    """
    header = {"format": FORMAT, "step": checkpoint.step, "parts": checkpoint.parts, "facts": checkpoint.facts}
    data = safetensors.torch.save(dict(checkpoint.tensors), {"robosim": json.dumps(header)})
    _write(folder / f"{checkpoint.step:012d}.safetensors", data)
    _tidy(folder)


def write_part(folder: Path, name: str, tensors: Mapping[str, Tensor]) -> None:
    """Write a part of the experience, compressed; InputError when it cannot be written."""
    _write(folder / name, pa.compress(safetensors.torch.save(dict(tensors)), codec="zstd", asbytes=True))


def read_part(folder: Path, name: str) -> dict[str, Tensor]:
    """Return a part of the experience; InputError when it is missing or damaged."""
    path = folder / name
    with (
        _whole(path, "part of a checkpoint"),
        pa.CompressedInputStream(pa.OSFile(str(path)), "zstd") as stream,
    ):
        return safetensors.torch.load(stream.read())


def list_checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints in a folder, latest first."""
    if not folder.is_dir():
        return []
    return sorted(folder.glob("[0-9]" * 12 + ".safetensors"), reverse=True)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint; InputError in one sentence when it is damaged."""
    header = _read_header(path)
    with _whole(path, "checkpoint"):
        tensors = safetensors.torch.load(path.read_bytes())
        return Checkpoint(int(header["step"]), tensors, dict(header["facts"]), tuple(header["parts"]))


def _read_header(path: Path) -> dict[str, Any]:
    """Return what of a checkpoint is no tensor, without reading the rest; errors as in `read_checkpoint`."""
    # `safe_open` also finds a file that is longer or shorter than its tensors.
    with _whole(path, "checkpoint"), safetensors.safe_open(path, "numpy") as file:
        header: dict[str, Any] = json.loads(file.metadata()["robosim"])
        if header["format"] != FORMAT:
            raise InputError(f"{path}: its format is {header['format']!r}: this robosim reads {FORMAT}.")
    return header


@contextmanager
def _whole(path: Path, what: str) -> Iterator[None]:
    """Turn whatever shows that a file is no whole `what` into one sentence."""
    try:
        yield
    except InputError:
        raise
    except (OSError, safetensors.SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a whole {what} ({_reason(error)}).") from None


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split())[:200] or type(error).__name__


def _write(path: Path, data: bytes) -> None:
    with whole_file(path) as part, part.open("wb") as file:
        file.write(data)
        file.flush()
        # Before it takes its name: or a power cut could leave the name with nothing behind it.
        os.fsync(file.fileno())


def _tidy(folder: Path) -> None:
    """Remove all but the latest checkpoints, and parts that none of those needs."""
    kept = list_checkpoints(folder)
    for path in kept[_KEPT:]:
        path.unlink(missing_ok=True)
    needed: set[str] = set()
    for path in kept[:_KEPT]:
        try:
            needed.update(_read_header(path)["parts"])
        except InputError:
            # Damaged: whoever resumes is told; until then nothing is thrown away.
            return
    for path in folder.glob("experience-*"):
        if path.name not in needed:
            path.unlink(missing_ok=True)
