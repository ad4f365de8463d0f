"""Files from strangers, read within bounds: regular files of a limited size, and TOML and JSON in them."""

from __future__ import annotations

import contextlib
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from robosim.errors import InputError, printable

DEEPEST = 20
"""Tables and lists within each other, and keys with dots between them."""
LONGEST_WORD = 100
"""Characters of a number or of a key without quotes."""

_QUOTED = re.compile(
    r'"""(?:[^\\]|\\.)*?(?:"{3,5}|\\?\Z)'
    r"|'''.*?(?:'{3,5}|\Z)"
    r'|"(?:[^"\\\n]|\\.)*"?'
    r"|'[^'\n]*'?"
    r"|(?P<comment>#[^\n]*)",
    re.DOTALL,
)
"""Texts and comments of TOML; what is not closed goes on to where TOML gives up."""
_LONG_WORD = re.compile(rf"[\w+-]{{{LONGEST_WORD + 1}}}")
_DOTTED = re.compile(rf"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){{{DEEPEST}}}")
_BRACKETS = re.compile(r"[\[\]{}]")


def read_limited(path: Path, most: int, kind: str) -> bytes:
    """Return the bytes of a regular file of at most `most` bytes; InputError otherwise.

    `kind` is what the file should be, such as "arena file", for the sentence. A pipe in its place is not
    waited for, and nothing of a file that is too large is read.
    """
    with _regular_file(path, kind) as file:
        size = os.fstat(file.fileno()).st_size
        # A file may grow while it is read.
        data = b"" if size > most else file.read(most + 1)
    if size > most or len(data) > most:
        raise InputError(f"{path}: larger than {most} bytes, the most that {_one(kind)} may have.")
    return data


def read_lines(path: Path, longest: int, kind: str) -> Iterator[bytes]:
    """Yield the lines of a regular file, without their ends; a last one that has none is left out.

    One line is held at a time, whatever the size of the file. InputError for anything but a regular file, and
    for a line of more than `longest` bytes; `kind` as in `read_limited`.
    """
    with _regular_file(path, kind) as file:
        number = 0
        while line := file.readline(longest + 1):
            number += 1
            if line.endswith(b"\n"):
                yield line[:-1]
            elif len(line) > longest:
                raise InputError(
                    f"{path}: line {number} is longer than {longest} bytes, the most it may have."
                )


@contextlib.contextmanager
def _regular_file(path: Path, kind: str) -> Iterator[BinaryIO]:
    """Give a regular file, open for reading; InputError for what is none or cannot be read."""
    try:
        # Looked at once it is open: another may take its place before.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
        with open(handle, "rb") as file:  # noqa: PTH123  a handle is no path
            mode = os.fstat(handle).st_mode
            if stat.S_ISDIR(mode):
                raise IsADirectoryError
            if not stat.S_ISREG(mode):
                raise InputError(f"{path}: not a regular file, as {_one(kind)} must be.")
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such {kind}.") from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a directory; {_one(kind)} is needed here.") from None
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"{path}: cannot be read: {reason}.") from None


def _one(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeioO' else 'a'} {kind}"


def read_text(path: Path, most: int, kind: str) -> str:
    """Return the text of a regular file of at most `most` bytes of UTF-8; errors as in `read_limited`."""
    data = read_limited(path, most, kind)
    try:
        # Some editors begin a file with a mark of byte order.
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8, as it must be in {_one(kind)}.") from None


def read_toml(path: Path, most: int, kind: str) -> dict[str, Any]:
    """Return the tables in a file of at most `most` bytes; InputError in one sentence if it is not TOML.

    `kind` as in `read_limited`.
    """
    return parse_toml(read_text(path, most, kind), str(path))


def parse_toml(text: str, place: str) -> dict[str, Any]:
    """Return the tables in a text; InputError in one sentence, that begins with `place`, if it is not TOML.

    Depth and lengths are looked at first: a key of a hundred thousand parts, within a file of a few hundred
    kilobytes, would take gigabytes and minutes to read.
    """
    try:
        _check_bounds(text)
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{place}: not a TOML file ({printable(str(error), 200)}).") from None


def _check_bounds(text: str) -> None:
    # What stands in quotes has no structure; a key of its own remains one.
    bare = _QUOTED.sub(lambda found: "" if found["comment"] else "q", text.replace("\r\n", "\n"))
    if long := _LONG_WORD.search(bare):
        word = printable(long[0], 20)
        raise ValueError(f"a number, or a key without quotes, of more than {LONGEST_WORD} characters: {word}")
    if _DOTTED.search(bare):
        raise ValueError(f"a key of more than {DEEPEST} parts")
    depth = 0
    for bracket in _BRACKETS.findall(bare):
        depth += 1 if bracket in "[{" else -1
        if depth > DEEPEST:
            raise ValueError(f"tables and lists more than {DEEPEST} deep")


def parse_json(text: str | bytes) -> Any:
    """Return what a JSON text holds; ValueError if it is none, nested too deeply, or has a number too long.

    Not a number and infinity are no JSON.
    """
    try:
        return json.loads(text, parse_int=_whole, parse_constant=_constant)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _whole(digits: str) -> int:
    if len(digits) > LONGEST_WORD:
        raise ValueError(f"a number of more than {LONGEST_WORD} digits")
    return int(digits)


def _constant(name: str) -> Any:
    raise ValueError(f"{name} is no JSON")
