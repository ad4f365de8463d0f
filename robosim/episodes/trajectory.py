"""A recorded episode: environment, seed and actions, from which all else can be run again to the last bit."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robosim.envs.config import EnvConfig
from robosim.equality import EqualByValue
from robosim.errors import InputError, name_or_path, printable, shown
from robosim.files import ARCHIVE_DAMAGE, require_writable, whole_file
from robosim.robot.drivers import ACTION_NAMES
from robosim.texts import parse_json, read_limited

SUFFIX = ".npz"
"""What the name of a trajectory's file ends in."""
LONGEST_POLICY = 4096
"""Characters of a trajectory's `policy`."""

_FORMAT = 4
_FIELDS = ("format", "config", "seed", "episode", "chosen", "policy")
_DRAWN = "drawn"
"""The field that is there under a profile alone."""
_LARGEST = 2**28
"""Bytes of the actions: three days of decisions of a hundred robots."""
_LARGEST_FILE = 2**28
_LONGEST_TEXT = 10_000_000
"""Bytes of the configuration, and of what was drawn; an arena's text takes up to a million characters."""
_HEAD = 200
"""Bytes of an array in a file that are not its numbers."""
_MOST = {
    "format": _HEAD,
    "config": _HEAD + _LONGEST_TEXT,
    "seed": _HEAD,
    "episode": _HEAD,
    "chosen": _HEAD + _LARGEST,
    "policy": _HEAD + 4 * LONGEST_POLICY,
    _DRAWN: _HEAD + _LONGEST_TEXT,
}
"""Bytes that a field takes at most, unpacked."""
_Values = dict[str, NDArray[np.generic]]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory(EqualByValue):
    """One environment's episode."""

    config: EnvConfig
    """What the environment is, with the text of its arena."""
    seed: int
    """Seed of the environment."""
    episode: int
    """Which of the seed's episodes it is."""
    chosen: NDArray[np.uint8]
    """[decisions, robots] actions."""
    policy: str = ""
    """Who drove, in a line of at most `LONGEST_POLICY` printable characters; empty if unknown."""
    drawn: Mapping[str, Any] | None = None
    """What the episode drew from its profile (`MotionDraws.table`), which a replay must draw again; None
    without a profile."""

    @property
    def robots(self) -> int:
        return int(self.chosen.shape[1])

    def save(self, path: str | Path) -> None:
        """Write the trajectory to an .npz file, whole or not at all; InputError if that cannot be."""
        require_place(path)
        _check_policy(Path(path), self.policy)
        drawn: dict[str, Any] = {}
        if self.drawn is not None:
            drawn[_DRAWN] = _bytes(json.dumps(dict(self.drawn)))
        with whole_file(path) as part, part.open("wb") as file:
            np.savez_compressed(
                file,
                format=np.int64(_FORMAT),
                config=_bytes(self.config.model_dump_json()),
                seed=np.uint64(self.seed),
                episode=np.int64(self.episode),
                chosen=self.chosen,
                policy=_bytes(self.policy),
                **drawn,
            )


def _bytes(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(text.encode(), dtype=np.uint8)


def require_place(path: str | Path) -> None:
    """Raise InputError now, before long work, if a trajectory cannot be saved there later."""
    if Path(path).suffix != SUFFIX:
        raise InputError(f"{path}: cannot be written: the name of a trajectory's file must end in {SUFFIX}.")
    require_writable(path)


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory; raises InputError for a file that is none, and runs no code from it."""
    source = Path(name_or_path("trajectory", path))
    # In memory: what is looked at is what is read.
    packed = io.BytesIO(read_limited(source, _LARGEST_FILE, "trajectory"))
    try:
        with zipfile.ZipFile(packed) as archive:
            _check_members(source, archive)
        packed.seek(0)
        with np.load(packed, allow_pickle=False) as file:
            _require(source, ("format",), file.files)
            number = _whole(source, "format", np.asarray(file["format"]))
            if number != _FORMAT:
                raise _refused(source, "format", number, f"{_FORMAT}")
            _require(source, _FIELDS, file.files)
            there = [*_FIELDS, *({_DRAWN} & set(file.files))]
            values = {name: np.asarray(file[name]) for name in there}
    except InputError:
        raise
    except (OSError, *ARCHIVE_DAMAGE) as error:
        raise InputError(f"{source}: is no trajectory ({_one_line(error)}).") from None
    return _checked(source, values)


def _check_members(source: Path, archive: zipfile.ZipFile) -> None:
    """Raise InputError for members that unpack to more than a trajectory holds."""
    for entry in archive.infolist():
        name = entry.filename.removesuffix(".npy")
        # What is no field is not unpacked, and zipfile stops where a member is longer than it says.
        if entry.file_size > _MOST.get(name, entry.file_size):
            raise InputError(
                f"{source}: is no trajectory; {name} takes {entry.file_size} bytes, but may take at most "
                f"{_MOST[name]}."
            )


def _require(source: Path, names: tuple[str, ...], there: list[str]) -> None:
    missing = [name for name in names if name not in there]
    if missing:
        raise InputError(f"{source}: is no trajectory; it lacks {', '.join(missing)}.")


def _checked(source: Path, values: _Values) -> Trajectory:
    config = _config(source, values)
    chosen = _chosen(source, values["chosen"], len(ACTION_NAMES[config.actions]))
    if chosen.shape[1] != config.robots:
        raise _refused(source, "chosen", _described(chosen), f"bytes [decisions, {config.robots}]")
    policy = _text(source, "policy", values)
    _check_policy(source, policy)
    return Trajectory(
        config=config,
        seed=_whole(source, "seed", values["seed"]),
        episode=_whole(source, "episode", values["episode"]),
        chosen=chosen,
        policy=policy,
        drawn=_table(source, _DRAWN, values) if _DRAWN in values else None,
    )


def _config(source: Path, values: _Values) -> EnvConfig:
    return EnvConfig.from_table(_table(source, "config", values), f"{source}: config")


def _table(source: Path, name: str, values: _Values) -> dict[str, Any]:
    # Parsed, a text takes many times its size.
    if len(values[name].ravel()) > _LONGEST_TEXT:
        found = _described(values[name])
        raise _refused(source, name, found, f"at most {_LONGEST_TEXT} bytes of a text")
    text = _text(source, name, values)
    try:
        table = parse_json(text)
    except ValueError as error:
        raise InputError(f"{source}: {name} is not JSON ({_one_line(error)}).") from None
    if not isinstance(table, dict):
        raise _refused(source, name, shown(table), "a table")
    return table


def _whole(source: Path, name: str, value: NDArray[np.generic]) -> int:
    allowed = "one whole number from 0"
    if value.shape != () or value.dtype.kind not in "iu":
        raise _refused(source, name, _described(value), allowed)
    number = int(value)
    if number < 0:
        raise _refused(source, name, number, allowed)
    return number


def _chosen(source: Path, value: NDArray[np.generic], num_actions: int) -> NDArray[np.uint8]:
    allowed = f"bytes [decisions, robots] from 0 to {num_actions - 1}"
    if value.dtype != np.uint8 or value.ndim != 2 or value.shape[1] < 1:
        raise _refused(source, "chosen", _described(value), allowed)
    chosen = value.astype(np.uint8)
    wrong = chosen[chosen >= num_actions]
    if len(wrong):
        raise _refused(source, "chosen", wrong[0], allowed)
    return chosen


def _text(source: Path, name: str, values: _Values) -> str:
    value = values[name]
    if value.ndim != 1 or value.dtype != np.uint8:
        raise _refused(source, name, _described(value), "the bytes of a text")
    try:
        return value.tobytes().decode()
    except UnicodeDecodeError as error:
        raise _refused(source, name, f"byte {error.start}", "UTF-8 text") from None


def _check_policy(source: Path, policy: str) -> None:
    # The file may come from a stranger: what it says must not steer a terminal.
    allowed = f"one line of at most {LONGEST_POLICY} printable characters"
    if len(policy) > LONGEST_POLICY:
        raise _refused(source, "policy", f"a text of {len(policy)} characters", allowed)
    if not policy.isprintable():
        raise _refused(source, "policy", ascii(policy), allowed)


def _refused(source: Path, name: str, value: object, allowed: str) -> InputError:
    return InputError(f"{source}: {name} is {value}, but must be {allowed}.")


def _described(value: NDArray[np.generic]) -> str:
    if value.shape == () and value.dtype.kind in "iufb":
        return str(value.item())
    return f"{value.dtype.name} {list(value.shape)}"


def _one_line(error: BaseException) -> str:
    return printable(" ".join(str(error).split()) or type(error).__name__, 200)
