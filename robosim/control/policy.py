"""Trained policies: read, checked and run in numpy alone."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import ArrayLike, NDArray

from robosim.arena.shipped import shipped_folder
from robosim.control.card import MOST_BYTES, PolicyCard, card_text, read_card
from robosim.control.html import policy_html
from robosim.control.network import IN_PLACE_FIELDS, Networks, Weights, check_weights
from robosim.envs.config import MOST_CONFIG
from robosim.errors import InputError, nearest_names, printable, shown
from robosim.errors import name_or_path as text_of
from robosim.files import is_regular, require_unchanged
from robosim.texts import parse_json, read_limited, read_text

WEIGHTS_FILE = "policy.safetensors"
CARD_FILE = "card.json"
README_FILE = "README.md"
CLIP_FILE = "clip.webp"
"""Beside a policy that is published: a page made of its card, and the team in motion."""
RUN_POLICY = "policy"
"""Name of the policy folder inside a run folder."""
RUN_CONFIG = "config.toml"
"""Name of a run's configuration inside its folder."""
RUN_RECORD = "finished.json"
"""Name of the last record of a run inside its folder."""

_DTYPES: dict[str, np.dtype[np.floating]] = {"F32": np.dtype("<f4"), "F16": np.dtype("<f2")}
_MOST_HEADER = 1_000_000
_MOST_WEIGHTS = 2_000_000_000
"""Bytes that the networks of a team may take in memory."""


class Policy:
    """What a team does: its networks, from the observations of the robots to their actions."""

    def __init__(self, weights: Weights, card: PolicyCard, place: str = "weights") -> None:
        """Take the weights of the card's networks.

        InputError, in one sentence that begins with `place`, if they do not fit the card.
        """
        self.card = card
        self._networks = Networks(card.network, weights, card.columns, place)
        self._stored = {name: np.asarray(array, np.float32) for name, array in weights.items()}

    @property
    def robots(self) -> int:
        """Robots in the team that learned; one network for all drives any other number as well."""
        return self.card.robots

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Return copies of `layer0.weight` [networks, in, out], `layer0.bias` [networks, out] and so on."""
        return {name: array.copy() for name, array in self._stored.items()}

    def act(
        self, observation: ArrayLike, decision: int | None = None, retreats: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Return the action of every robot, [..., robots], from `observation` [..., robots, size].

        The one of the largest output; the lowest index among equals. A policy whose card has a temperature
        draws its actions instead, and needs the number of the `decision` since the episode began: equal
        numbers and observations give equal actions. One whose robots retreat needs `retreats` besides, int64
        [..., robots], which it changes (`robosim.control.player.Player` keeps it). InputError for a wrong
        shape, an observation that is not finite, and a number or array that is missing.
        """
        return self._networks.act(self._checked(observation), decision, retreats)

    def values(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return what the networks put out, as `Networks.outputs` does; errors as in `act`."""
        return self._networks.outputs(self._checked(observation))

    def _repr_html_(self) -> str:
        return policy_html(self)

    def _checked(self, observation: ArrayLike) -> NDArray[np.float32]:
        size = len(self.card.observation)
        try:
            inputs = np.asarray(observation, np.float32)
        except (TypeError, ValueError) as error:
            raise InputError(f"observation is not an array of numbers: {error}.") from None
        robots = self.robots
        if self.card.network.shared and inputs.ndim > 1:
            # Any number of them, but not none.
            robots = inputs.shape[-2] or robots
        if inputs.shape[-2:] != (robots, size):
            raise InputError(
                f"observation has shape {inputs.shape}: its last two axes must be robots and size, "
                f"{(robots, size)}."
            )
        finite = np.isfinite(inputs)
        if not finite.all():
            place = tuple(int(i) for i in np.argwhere(~finite)[0])
            name = self.card.observation[place[-1]]
            raise InputError(
                f"observation is {inputs[place]} at {place}, the {name!r} of robot {place[-2]}: "
                "it must be a finite number."
            )
        return inputs


def policy_names() -> list[str]:
    """Names of the policies that ship, in an order in which paper-2 comes before paper-16."""
    try:
        folder = shipped_folder("policies")
    except InputError:
        return []
    names = [path.name for path in folder.iterdir() if (path / CARD_FILE).is_file()]
    return sorted(names, key=_natural)


def _natural(name: str) -> list[tuple[str, int]]:
    """Return what names are sorted by so that the numbers in them count as such."""
    return [(text, int(digits or -1)) for text, digits in re.findall(r"([^0-9]*)([0-9]*)", name)]


def folder_size(folder: Path) -> int:
    """Return the bytes of a policy: of its card and its weights."""
    return sum((folder / name).stat().st_size for name in (CARD_FILE, WEIGHTS_FILE))


def load_policy(name_or_path: str | Path) -> Policy:
    """Load a policy that ships, by name, or a policy or run folder, by path. Runs no code from it.

    InputError in one sentence for a name nobody knows, and for a folder that is not a whole, sound policy.
    """
    return read_policy(find_policy(name_or_path))


def read_policy(folder: Path) -> Policy:
    """Read a policy folder; InputError in one sentence if it is not whole and sound."""
    if folder.name == RUN_POLICY:
        check_run(folder.parent)
    card = read_card(folder / CARD_FILE)
    path = folder / WEIGHTS_FILE
    return Policy(_read_weights(path, card), card, str(path))


def team_digest(folder: Path) -> str:
    """Return the SHA-256 by which records know the team of a policy folder.

    That of its weights; a card that lets robots in place draw otherwise counts, too, since the same weights
    serve with and without. InputError for a folder that is not sound.
    """
    digest = hashlib.sha256((folder / WEIGHTS_FILE).read_bytes())
    network = read_card(folder / CARD_FILE).network
    for name in IN_PLACE_FIELDS:
        if getattr(network, name) is not None:
            digest.update(f"{name}={getattr(network, name)}".encode())
    return digest.hexdigest()


def configuration_of(name_or_path: str | Path) -> str | None:
    """Return the configuration of the run whose policy that is, as TOML; None for a policy outside a run."""
    folder = find_policy(name_or_path)
    config = folder.parent / RUN_CONFIG
    if folder.name != RUN_POLICY or not config.is_file():
        return None
    return read_text(config, MOST_CONFIG, "run configuration")


def check_run(folder: Path) -> None:
    """Raise InputError if a file of a finished run is not what the run wrote, by the digests it left.

    Where no run has finished, there is nothing to check by.
    """
    path = folder / RUN_RECORD
    try:
        if not is_regular(path):
            return
        files = parse_json(read_limited(path, MOST_BYTES, "record of a run")).get("files", {})
        require_unchanged(folder, {str(name): str(digest) for name, digest in files.items()})
    except InputError:
        raise
    except (ValueError, AttributeError):
        raise InputError(f"{path}: not the last record of a run.") from None


def save_policy(folder: Path, weights: Weights, card: PolicyCard) -> None:
    """Write a policy folder, whole or not at all; a policy that is there already is replaced, with its page.

    `weights` are of the shapes and the precision that `card.network` states; the card is told their SHA-256.
    InputError if they do not fit the card, or if `folder` holds anything but a policy.
    """
    check_weights(card.network, weights, "weights")
    stored = safetensors.numpy.save({name: np.ascontiguousarray(array) for name, array in weights.items()})
    card = card.changed(weights_sha256=hashlib.sha256(stored).hexdigest())
    text = card_text(card).encode("utf-8")
    if len(text) > MOST_BYTES:
        raise InputError(f"the card takes {len(text)} bytes, but must take at most {MOST_BYTES}.")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: this is a file; a policy is written to a folder.")
    known = {WEIGHTS_FILE, CARD_FILE, README_FILE, CLIP_FILE}
    if folder.is_dir() and (strange := {path.name for path in folder.iterdir()} - known):
        raise InputError(f"{folder}: holds {shown(min(strange))}, so it is not replaced by a policy.")
    parent = folder.absolute().parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
        # Beside the target, since a rename is atomic within one file system only.
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=parent) as scratch:
            fresh, former = Path(scratch) / "new", Path(scratch) / "old"
            fresh.mkdir()
            # Not by save_file, which lets nobody but the owner read the file.
            (fresh / WEIGHTS_FILE).write_bytes(stored)
            (fresh / CARD_FILE).write_bytes(text)
            if folder.exists():
                folder.rename(former)
            try:
                fresh.rename(folder)
            except BaseException:
                if former.exists() and not folder.exists():
                    former.rename(folder)
                raise
    except OSError as error:
        raise InputError(f"{folder}: the policy cannot be written: {error.strerror or error}.") from error


def find_policy(name_or_path: str | Path, scripted: Iterable[str] = ()) -> Path:
    """Return the folder of a policy that ships, by name, or else of a policy or run folder, by path.

    InputError for what is none, with the nearest names; `scripted` are names that would also have done.
    """
    text = text_of("policy", name_or_path)
    names = policy_names()
    if text in names:
        return shipped_folder("policies") / text
    path = Path(text)
    try:
        found, is_folder = path.exists(), path.is_dir()
    except (OSError, ValueError):
        found = is_folder = False
    if not found:
        known = [*scripted, *names]
        near = f": {nearest_names(text, known)}" if known else "."
        raise InputError(f"no policy is named '{printable(text, 200)}', and there is no such folder{near}")
    if not is_folder:
        raise InputError(f"{path}: this is a file; give the policy's folder.")
    for folder in (path, path / RUN_POLICY):
        if (folder / CARD_FILE).exists() or (folder / WEIGHTS_FILE).exists():
            return folder
    raise InputError(
        f"{path}: neither a policy folder ({CARD_FILE} and {WEIGHTS_FILE}) nor a run folder ({RUN_POLICY}/)."
    )


def _read_weights(path: Path, card: PolicyCard) -> dict[str, NDArray[np.floating]]:
    network = card.network
    each = 1 if network.networks == 1 else network.robots
    if 4 * network.numbers * each > _MOST_WEIGHTS:
        raise InputError(
            f"{path}: {each} networks of {network.numbers} numbers need more than {_MOST_WEIGHTS} bytes, "
            "the most a policy may take."
        )
    data = read_limited(path, 4 * network.numbers * network.networks + _MOST_HEADER, "weights file")
    if card.weights_sha256 and hashlib.sha256(data).hexdigest() != card.weights_sha256:
        raise InputError(f"{path}: not the weights of this card: their SHA-256 is another.")
    try:
        tensors: list[tuple[str, dict[str, Any]]] = safetensors.deserialize(data)  # type: ignore[no-untyped-call]
    except safetensors.SafetensorError as error:
        raise InputError(f"{path}: not a whole safetensors file ({error}).") from None
    weights: dict[str, NDArray[np.floating]] = {}
    for name, tensor in tensors:
        dtype = _DTYPES.get(tensor["dtype"])
        if dtype is None:
            raise InputError(f"{path}: {shown(name)} is of type {tensor['dtype']}, but must be F32 or F16.")
        weights[name] = np.frombuffer(tensor["data"], dtype).reshape(tensor["shape"])
    return weights
