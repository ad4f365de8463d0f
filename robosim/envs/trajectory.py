"""A recorded episode: seed and actions, from which everything else can be run again to the last bit."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robosim.errors import InputError
from robosim.files import whole_file
from robosim.robot.drivers import ACTION_KINDS, NUM_ACTIONS, ActionKind

_FIELDS = ("format", "arena", "actions", "seed", "episode", "chosen")
_FORMAT = 1
_LARGEST = 2**30
_DAMAGE = (
    ValueError,
    EOFError,
    KeyError,
    RuntimeError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)
"""What zipfile and numpy raise for files that are damaged, encrypted, or lie about their size."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One environment's episode."""

    arena: str
    """Text of the arena file."""
    actions: ActionKind
    seed: int
    """Seed of the environment."""
    episode: int
    """Which of the seed's episodes it is."""
    chosen: NDArray[np.uint8]
    """[decisions, robots] actions."""

    @property
    def robots(self) -> int:
        return int(self.chosen.shape[1])

    def save(self, path: str | Path) -> None:
        """Write the trajectory to an .npz file, whole or not at all."""
        with whole_file(path) as part, part.open("wb") as file:
            np.savez_compressed(
                file,
                format=np.int64(_FORMAT),
                arena=np.frombuffer(self.arena.encode(), dtype=np.uint8),
                actions=np.int64(ACTION_KINDS.index(self.actions)),
                seed=np.uint64(self.seed),
                episode=np.int64(self.episode),
                chosen=self.chosen,
            )


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory; raises InputError for a file that is none, and runs no code from it."""
    source = Path(path)
    try:
        with zipfile.ZipFile(source) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _LARGEST:
                raise InputError(f"{source}: holds more than {_LARGEST} bytes, too large for a trajectory.")
        with np.load(source, allow_pickle=False) as file:
            missing = [name for name in _FIELDS if name not in file]
            if missing:
                raise InputError(f"{source}: is no trajectory; it lacks {', '.join(missing)}.")
            values = {name: np.asarray(file[name]) for name in _FIELDS}
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror or error}).") from None
    except _DAMAGE as error:
        raise InputError(f"{source}: is no trajectory ({error}).") from None
    return _checked(source, values)


def _checked(source: Path, values: dict[str, NDArray[np.generic]]) -> Trajectory:
    for name in ("format", "actions", "seed", "episode"):
        if values[name].shape != () or values[name].dtype.kind not in "iu" or int(values[name]) < 0:
            raise InputError(f"{source}: {name} must be one whole number from 0.")
    if int(values["format"]) != _FORMAT:
        raise InputError(f"{source}: format {int(values['format'])} is unknown; known is {_FORMAT}.")
    if int(values["actions"]) >= len(ACTION_KINDS):
        raise InputError(f"{source}: actions must be 0 to {len(ACTION_KINDS) - 1}.")
    arena = values["arena"]
    given = values["chosen"]
    wrong = InputError(f"{source}: chosen must be bytes [decisions, robots] from 0 to {NUM_ACTIONS - 1}.")
    if given.dtype != np.uint8 or given.ndim != 2 or given.shape[1] < 1:
        raise wrong
    chosen = given.astype(np.uint8)
    if (chosen >= NUM_ACTIONS).any():
        raise wrong
    if arena.ndim != 1 or arena.dtype != np.uint8:
        raise InputError(f"{source}: arena must be the bytes of a text.")
    try:
        text = arena.tobytes().decode()
    except UnicodeDecodeError:
        raise InputError(f"{source}: arena must be UTF-8 text.") from None
    return Trajectory(
        arena=text,
        actions=ACTION_KINDS[int(values["actions"])],
        seed=int(values["seed"]),
        episode=int(values["episode"]),
        chosen=chosen,
    )
