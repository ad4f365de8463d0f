"""Checkpoints: everything that a run goes on from, written whole, so that a kill at any moment costs little.

A checkpoint is one file, `NNNNNNNNNNNN.safetensors`, with tensors and, as JSON in its header, all else.
Experience is kept beside it in parts, each written once and shared by the checkpoints after it. Each of them
holds its own SHA-256, so that no bit of it changes unnoticed. Reading runs no code from any of them.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import safetensors
import safetensors.torch
from torch import Tensor

from robosim.errors import InputError
from robosim.files import is_regular, write_whole

FORMAT = "robosim-checkpoint-2"
_CHECKPOINT = re.compile(r"\d{12}\.safetensors")
_PART = re.compile(r"experience-\d{4}-\d{12}-\d{12}\.zst")
_BEFORE_DIGITS = b'{\\"sha256\\": \\"'
"""What stands before the digest: JSON in a string of the JSON that is safetensors' header."""
_DIGITS = 64
_KEPT = 2
"""Checkpoints kept: the latest, and the one before for the case that the latest is damaged."""


@dataclass(frozen=True, slots=True, eq=False)
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
    data = _sealed(checkpoint.tensors, header)
    write_whole(folder / f"{checkpoint.step:012d}.safetensors", data, durable=True)
    _tidy(folder)


def write_part(folder: Path, name: str, tensors: Mapping[str, Tensor]) -> None:
    """Write a part of the experience, compressed; InputError when it cannot be written.

    `name` is `experience-STAGE-FIRST-LAST.zst`, with 4, 12 and 12 digits.
    """
    data = pa.compress(_sealed(tensors, {}), codec="zstd", asbytes=True)
    write_whole(folder / name, data, durable=True)


def read_part(folder: Path, name: str) -> dict[str, Tensor]:
    """Return a part of the experience; InputError when it is missing or damaged."""
    path = folder / name
    with (
        _whole(path, "part of a checkpoint"),
        pa.CompressedInputStream(pa.OSFile(str(path)), "zstd") as stream,
    ):
        data = stream.read()
        _check_seal(data)
        return safetensors.torch.load(data)


def list_checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints in a folder, latest first."""
    return sorted((path for path in _written(folder) if _CHECKPOINT.fullmatch(path.name)), reverse=True)


def is_checkpoint_file(name: str) -> bool:
    """Return whether checkpoints and their parts have such names."""
    return bool(_CHECKPOINT.fullmatch(name) or _PART.fullmatch(name))


def remove_checkpoints(folder: Path) -> None:
    """Remove all checkpoints and parts in a folder, and the folder if nothing else is in it."""
    for path in _written(folder):
        path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint; InputError in one sentence when it is damaged."""
    header = _read_header(path)
    with _whole(path, "checkpoint"):
        data = path.read_bytes()
        _check_seal(data)
        tensors = safetensors.torch.load(data)
        return Checkpoint(int(header["step"]), tensors, dict(header["facts"]), tuple(header["parts"]))


def _read_header(path: Path) -> dict[str, Any]:
    """Return what of a checkpoint is no tensor, without reading the rest; errors as in `read_checkpoint`."""
    # `safe_open` also finds a file that is longer or shorter than its tensors.
    with _whole(path, "checkpoint"), safetensors.safe_open(path, "numpy") as file:
        header: dict[str, Any] = json.loads(file.metadata()["robosim"])
        if header["format"] != FORMAT:
            raise InputError(f"{path}: its format is {header['format']!r}: this robosim reads {FORMAT}.")
    return header


def _sealed(tensors: Mapping[str, Tensor], header: Mapping[str, Any]) -> bytes:
    """Return a safetensors file with `header` as JSON and, in front of it, the SHA-256 of the file.

    Of the file as it is with zeros in the place of these digits.
    """
    blank = "0" * _DIGITS
    data = safetensors.torch.save(dict(tensors), {"robosim": json.dumps({"sha256": blank, **header})})
    place = data.index(_BEFORE_DIGITS) + len(_BEFORE_DIGITS)
    return data[:place] + hashlib.sha256(data).hexdigest().encode() + data[place + _DIGITS :]


def _check_seal(data: bytes) -> None:
    """Raise ValueError unless a file is to the bit what `_sealed` made."""
    place = data.index(_BEFORE_DIGITS) + len(_BEFORE_DIGITS)
    blank = data[:place] + b"0" * _DIGITS + data[place + _DIGITS :]
    if hashlib.sha256(blank).hexdigest().encode() != data[place : place + _DIGITS]:
        raise ValueError("its SHA-256 is not that of what was written")


@contextlib.contextmanager
def _whole(path: Path, what: str) -> Iterator[None]:
    """Turn whatever shows that a file is no whole `what` into one sentence."""
    # A pipe in its place would be waited for.
    if path.exists() and not is_regular(path):
        raise InputError(f"{path}: not a whole {what} (it is not a regular file).")
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


def _written(folder: Path) -> list[Path]:
    """Return the files in a folder that are named as those written here; what else lies there is not ours."""
    if folder.is_symlink() or not folder.is_dir():
        return []
    return [path for path in folder.iterdir() if is_checkpoint_file(path.name) and is_regular(path)]


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
            # Damaged: whoever resumes hears of it; until then nothing is thrown away.
            return
    for path in _written(folder):
        if _PART.fullmatch(path.name) and path.name not in needed:
            path.unlink(missing_ok=True)
