"""A recorded episode: seed and actions, from which everything else can be run again to the last bit."""

from __future__ import annotations

import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from pathlib import Path
from typing import TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.pheromone import PheromoneConfig
from robosim.discretise.reward import REWARD_KINDS, RewardKind, Sharing
from robosim.errors import InputError
from robosim.files import require_writable, whole_file
from robosim.robot.drivers import ACTION_KINDS, NUM_ACTIONS, ActionKind

SUFFIX = ".npz"
"""What the name of a trajectory's file ends in."""
LONGEST_POLICY = 4096
"""Characters of a trajectory's `policy`."""

MAX_PELLET_GRADIENT = 50.0
"""The largest `pellet_gradient` of an environment."""

_FORMAT = 3
_FIRST_FIELDS = ("format", "arena", "actions", "seed", "episode", "chosen")
_SECOND_FIELDS = (*_FIRST_FIELDS, "pheromone", "reward", "sharing", "signed_progress", "policy")
_FIELDS = {
    1: _FIRST_FIELDS,
    2: _SECOND_FIELDS,
    3: (*_SECOND_FIELDS, "idle_cost", "pellet_gradient"),
}
"""By format."""
_SHARINGS: tuple[Sharing, ...] = get_args(Sharing)
_LARGEST = 2**30
_DAMAGE = (
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
"""What zipfile and numpy raise for files that are damaged, encrypted, or lie about their size."""

_Choice = TypeVar("_Choice")
_Values = dict[str, NDArray[np.generic]]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One environment's episode.

    The fields up to `pellet_gradient` say how bodies move. The others do not touch them: they say what a
    recording shows beside.
    """

    arena: str
    """Text of the arena file."""
    actions: ActionKind
    seed: int
    """Seed of the environment."""
    episode: int
    """Which of the seed's episodes it is."""
    chosen: NDArray[np.uint8]
    """[decisions, robots] actions."""
    pellet_gradient: float = 0.0
    """Of the environment."""
    pheromone: PheromoneConfig = field(default_factory=PheromoneConfig)
    reward: RewardKind = "global"
    sharing: Sharing = "copied"
    signed_progress: bool = False
    idle_cost: bool = False
    policy: str = ""
    """Who drove, in a line of at most `LONGEST_POLICY` printable characters; empty if unknown."""

    @property
    def robots(self) -> int:
        return int(self.chosen.shape[1])

    def save(self, path: str | Path) -> None:
        """Write the trajectory to an .npz file, whole or not at all; InputError if that cannot be."""
        require_place(path)
        _check_policy(Path(path), self.policy)
        with whole_file(path) as part, part.open("wb") as file:
            np.savez_compressed(
                file,
                format=np.int64(_FORMAT),
                arena=np.frombuffer(self.arena.encode(), dtype=np.uint8),
                actions=np.int64(ACTION_KINDS.index(self.actions)),
                seed=np.uint64(self.seed),
                episode=np.int64(self.episode),
                chosen=self.chosen,
                pheromone=np.array(astuple(self.pheromone), dtype=np.float64),
                reward=np.int64(REWARD_KINDS.index(self.reward)),
                sharing=np.int64(_SHARINGS.index(self.sharing)),
                signed_progress=np.int64(self.signed_progress),
                idle_cost=np.int64(self.idle_cost),
                pellet_gradient=np.float64(self.pellet_gradient),
                policy=np.frombuffer(self.policy.encode(), dtype=np.uint8),
            )


def require_place(path: str | Path) -> None:
    """Raise InputError now, before long work, if a trajectory cannot be saved there later."""
    if Path(path).suffix != SUFFIX:
        raise InputError(f"{path}: cannot be written: the name of a trajectory's file must end in {SUFFIX}.")
    require_writable(path)


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory; raises InputError for a file that is none, and runs no code from it.

    Files of format 1 know nothing of pheromones, rewards and policy, those of format 2 nothing of idle costs
    and gradients of pellets: these become the defaults.
    """
    source = Path(path)
    try:
        with zipfile.ZipFile(source) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _LARGEST:
                raise InputError(f"{source}: holds more than {_LARGEST} bytes, too large for a trajectory.")
        with np.load(source, allow_pickle=False) as file:
            _require(source, ("format",), file.files)
            number = _whole(source, "format", np.asarray(file["format"]))
            if number not in _FIELDS:
                raise _refused(source, "format", number, f"are {', '.join(map(str, _FIELDS))}")
            _require(source, _FIELDS[number], file.files)
            values = {name: np.asarray(file[name]) for name in _FIELDS[number]}
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror or error}).") from None
    except _DAMAGE as error:
        raise InputError(f"{source}: is no trajectory ({_one_line(error)}).") from None
    return _checked(source, values)


def _require(source: Path, names: Sequence[str], there: Sequence[str]) -> None:
    missing = [name for name in names if name not in there]
    if missing:
        raise InputError(f"{source}: is no trajectory; it lacks {', '.join(missing)}.")


def _checked(source: Path, values: _Values) -> Trajectory:
    first = Trajectory(
        arena=_text(source, "arena", values),
        actions=_choice(source, "actions", values, ACTION_KINDS),
        seed=_whole(source, "seed", values["seed"]),
        episode=_whole(source, "episode", values["episode"]),
        chosen=_chosen(source, values["chosen"]),
    )
    if "policy" not in values:
        return first
    policy = _text(source, "policy", values)
    _check_policy(source, policy)
    second = replace(
        first,
        pheromone=_pheromone(source, values["pheromone"]),
        reward=_choice(source, "reward", values, REWARD_KINDS),
        sharing=_choice(source, "sharing", values, _SHARINGS),
        signed_progress=_choice(source, "signed_progress", values, (False, True)),
        policy=policy,
    )
    if "idle_cost" not in values:
        return second
    return replace(
        second,
        idle_cost=_choice(source, "idle_cost", values, (False, True)),
        pellet_gradient=_gradient(source, values["pellet_gradient"]),
    )


def _gradient(source: Path, value: NDArray[np.generic]) -> float:
    allowed = f"is one number from 0 to {MAX_PELLET_GRADIENT:g}"
    if value.shape != () or value.dtype != np.float64:
        raise _refused(source, "pellet_gradient", _described(value), allowed)
    number = float(value)
    if not 0.0 <= number <= MAX_PELLET_GRADIENT:
        raise _refused(source, "pellet_gradient", number, allowed)
    return number


def _whole(source: Path, name: str, value: NDArray[np.generic]) -> int:
    allowed = "is one whole number from 0"
    if value.shape != () or value.dtype.kind not in "iu":
        raise _refused(source, name, _described(value), allowed)
    number = int(value)
    if number < 0:
        raise _refused(source, name, number, allowed)
    return number


def _choice(source: Path, name: str, values: _Values, choices: Sequence[_Choice]) -> _Choice:
    number = _whole(source, name, values[name])
    if number >= len(choices):
        allowed = "are " + " and ".join(f"{index} ({choice})" for index, choice in enumerate(choices))
        raise _refused(source, name, number, allowed)
    return choices[number]


def _chosen(source: Path, value: NDArray[np.generic]) -> NDArray[np.uint8]:
    allowed = f"are bytes [decisions, robots] from 0 to {NUM_ACTIONS - 1}"
    if value.dtype != np.uint8 or value.ndim != 2 or value.shape[1] < 1:
        raise _refused(source, "chosen", _described(value), allowed)
    chosen = value.astype(np.uint8)
    wrong = chosen[chosen >= NUM_ACTIONS]
    if len(wrong):
        raise _refused(source, "chosen", wrong[0], allowed)
    return chosen


def _text(source: Path, name: str, values: _Values) -> str:
    value = values[name]
    if value.ndim != 1 or value.dtype != np.uint8:
        raise _refused(source, name, _described(value), "are the bytes of a text")
    try:
        return value.tobytes().decode()
    except UnicodeDecodeError as error:
        raise _refused(source, name, f"byte {error.start}", "is UTF-8 text") from None


def _pheromone(source: Path, value: NDArray[np.generic]) -> PheromoneConfig:
    names = [one.name for one in fields(PheromoneConfig)]
    if value.dtype != np.float64 or value.shape != (len(names),):
        allowed = f"is float64 [{len(names)}]: {', '.join(names)}"
        raise _refused(source, "pheromone", _described(value), allowed)
    constants = dict(zip(names, value.tolist(), strict=True))
    if constants["radius"].is_integer():
        constants["radius"] = int(constants["radius"])
    try:
        return PheromoneConfig(**constants)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _check_policy(source: Path, policy: str) -> None:
    # The file may come from a stranger: what it says must not steer a terminal.
    allowed = f"is one line of at most {LONGEST_POLICY} printable characters"
    if len(policy) > LONGEST_POLICY:
        raise _refused(source, "policy", f"a text of {len(policy)} characters", allowed)
    if not policy.isprintable():
        raise _refused(source, "policy", ascii(policy), allowed)


def _refused(source: Path, name: str, value: object, allowed: str) -> InputError:
    return InputError(f"{source}: {name}: {value} is not allowed; allowed {allowed}.")


def _described(value: NDArray[np.generic]) -> str:
    if value.shape == () and value.dtype.kind in "iufb":
        return str(value.item())
    return f"{value.dtype.name} {list(value.shape)}"


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return "".join(character if character.isprintable() else "?" for character in text)
