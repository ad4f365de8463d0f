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

from robosim.errors import InputError, printable, shown
from robosim.files import is_regular, write_whole
from robosim.texts import read_limited

FORMAT = "robosim-checkpoint-2"
_CHECKPOINT = re.compile(r"\d{12}\.safetensors")
_PART = re.compile(r"experience-\d{4}-\d{12}-\d{12}\.zst")
_BEFORE_DIGITS = b'{\\"sha256\\": \\"'
"""What stands before the digest: JSON in a string of the JSON that is safetensors' header."""
_DIGITS = 64
_MOST_HEADER = 100_000
"""Bytes of a part that are no tensor."""
_AT_ONCE = 2**24
"""Bytes that are unpacked at once."""
_LONGEST_NUMBER = 50
"""Digits of a whole number in a header."""
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

    `name` is as `part_name` makes it.
    """
    data = pa.compress(_sealed(tensors, {}), codec="zstd", asbytes=True)
    write_whole(folder / name, data, durable=True)


def part_name(stage: int, first: int, last: int) -> str:
    """Return the name of the part that holds items `first` to `last - 1` of a stage's memory."""
    return f"experience-{stage:04d}-{first:012d}-{last:012d}.zst"


def read_part(folder: Path, name: str, most: int) -> dict[str, Tensor]:
    """Return a part of the experience that takes at most so many bytes in memory.

    InputError when it is missing or damaged, or takes more.
    """
    path = folder / name
    most += _MOST_HEADER
    with (
        _whole(path, "part of a checkpoint"),
        pa.CompressedInputStream(pa.OSFile(str(path)), "zstd") as stream,
    ):
        pieces, held = [], 0
        while piece := stream.read(_AT_ONCE):
            held += len(piece)
            if held > most:
                raise ValueError(f"unpacked, it takes more than {most} bytes, the most that its run holds")
            pieces.append(piece)
        data = b"".join(pieces)
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


def read_checkpoint(path: Path, most: int) -> Checkpoint:
    """Read a checkpoint of at most `most` bytes; InputError in one sentence when it is damaged, or larger."""
    header = _read_header(path)
    with _whole(path, "checkpoint"):
        data = read_limited(path, most, "checkpoint")
        _check_seal(data)
        tensors = safetensors.torch.load(data)
        return Checkpoint(int(header["step"]), tensors, dict(header["facts"]), tuple(header["parts"]))


def _read_header(path: Path) -> dict[str, Any]:
    """Return what of a checkpoint is no tensor, without reading the rest; errors as in `read_checkpoint`."""
    # `safe_open` also finds a file that is longer or shorter than its tensors.
    with _whole(path, "checkpoint"), safetensors.safe_open(path, "numpy") as file:
        header: dict[str, Any] = json.loads(file.metadata()["robosim"], parse_int=_whole_number)
        if header["format"] != FORMAT:
            raise InputError(f"{path}: its format is {shown(header['format'])}: this robosim reads {FORMAT}.")
    return header


def _whole_number(digits: str) -> int:
    # Enough for the states of generators; those too long for Python are an error of its own.
    if len(digits) > _LONGEST_NUMBER:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


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
    except (OSError, safetensors.SafetensorError, LookupError, TypeError, ValueError, ArithmeticError,
            AttributeError, RuntimeError) as error:  # fmt: skip
        raise InputError(f"{path}: not a whole {what} ({_reason(error)}).") from None


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return printable(" ".join(str(error).split()), 200) or type(error).__name__


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
