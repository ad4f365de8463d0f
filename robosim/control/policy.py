"""Trained policies: read, checked and run in numpy alone."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import ArrayLike, NDArray

from robosim.arena.shipped import shipped_folder
from robosim.control.card import PolicyCard, card_text, read_card, read_limited
from robosim.discretise.observation import gain_columns, mask_blocked_moves
from robosim.errors import InputError, nearest_names

WEIGHTS_FILE = "policy.safetensors"
CARD_FILE = "card.json"
RUN_POLICY = "policy"
"""Name of the policy folder inside a run folder."""

LEAST_SQUARE = 1e-5
"""Added to the mean square by which hidden layers are normalised."""

_DTYPES: dict[str, np.dtype[np.floating]] = {"F32": np.dtype("<f4"), "F16": np.dtype("<f2")}
_MOST_HEADER = 1_000_000
_MOST_BYTES = 2_000_000_000


class Policy:
    """The greedy policy of a team: each robot's own network, from its own observation to its action."""

    def __init__(self, weights: Mapping[str, NDArray[np.floating]], card: PolicyCard) -> None:
        """Take `layer0.weight` [networks, in, out], `layer0.bias` [networks, out] and so on, as in the card.

        There is a network for each robot, or those that the card's `network.of_robot` gives out.
        """
        _check_weights(weights, card, "weights")
        self.card = card
        # Rounded weights are widened once, here: products of float16 are slow and coarse on a CPU.
        stored = [
            (
                np.asarray(weights[f"layer{i}.weight"], np.float32),
                np.asarray(weights[f"layer{i}.bias"], np.float32),
            )
            for i in range(len(card.layers))
        ]
        if card.network.of_robot and not card.shared:
            of_robot = np.array(card.network.of_robot)
            stored = [(weight[of_robot], bias[of_robot]) for weight, bias in stored]
        self._weights = [np.ascontiguousarray(weight) for weight, _ in stored]
        self._biases = [bias[:, None] for _, bias in stored]
        self._progress = (
            gain_columns(card.observation.names, card.actions) if card.technique.action_mask else None
        )

    @property
    def robots(self) -> int:
        """Robots in the team that learned; one network for all drives any other number as well."""
        return self.card.robots

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Return copies of `layer0.weight` [robots, in, out], `layer0.bias` [robots, out] and so on."""
        arrays: dict[str, NDArray[np.float32]] = {}
        each = self.robots if self.card.shared else 1
        for i, (weight, bias) in enumerate(zip(self._weights, self._biases, strict=True)):
            arrays[f"layer{i}.weight"] = np.repeat(weight, each, axis=0)
            arrays[f"layer{i}.bias"] = np.repeat(bias[:, 0], each, axis=0)
        return arrays

    def act(self, observation: ArrayLike) -> NDArray[np.int64]:
        """Return the action of every robot, [..., robots], from `observation` [..., robots, size].

        The action of the largest value; the lowest index among equals. InputError for a wrong shape
        or an observation that is not finite.
        """
        chosen: NDArray[np.int64] = self.values(observation).argmax(axis=-1)
        return chosen

    def values(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return action values [..., robots, actions], computed in float32; errors as in `act`.

        What the policy does not choose, where its card has an `action_mask`, is worth minus infinity.
        """
        inputs = self._checked(observation)
        hidden = np.ascontiguousarray(inputs.reshape(-1, *inputs.shape[-2:]).swapaxes(0, 1))
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            hidden = hidden @ weight
            hidden += bias
            np.maximum(hidden, 0.0, out=hidden)
            if self.card.technique.normalised:
                square = np.mean(hidden * hidden, axis=-1, keepdims=True)
                hidden /= np.sqrt(square + np.float32(LEAST_SQUARE))
        values = (hidden @ self._weights[-1] + self._biases[-1]).swapaxes(0, 1)
        values = values.reshape(*inputs.shape[:-1], self.card.num_actions)
        return mask_blocked_moves(values, inputs, self._progress)

    def _checked(self, observation: ArrayLike) -> NDArray[np.float32]:
        size = len(self.card.observation.names)
        try:
            inputs = np.asarray(observation, np.float32)
        except (TypeError, ValueError) as error:
            raise InputError(f"observation is not an array of numbers: {error}.") from None
        robots = inputs.shape[-2] if self.card.shared and inputs.ndim > 1 else self.robots
        if inputs.shape[-2:] != (robots, size):
            raise InputError(
                f"observation has shape {inputs.shape}: its last two axes must be robots and size, "
                f"{(robots, size)}."
            )
        finite = np.isfinite(inputs)
        if not finite.all():
            place = tuple(int(i) for i in np.argwhere(~finite)[0])
            name = self.card.observation.names[place[-1]]
            raise InputError(
                f"observation is {inputs[place]} at {place}, the {name!r} of robot {place[-2]}: "
                "it must be a finite number."
            )
        return inputs


def policy_names() -> list[str]:
    """Names of the policies that ship, sorted."""
    try:
        folder = shipped_folder("policies")
    except InputError:
        return []
    return sorted(path.name for path in folder.iterdir() if (path / CARD_FILE).is_file())


def folder_size(folder: Path) -> int:
    """Return the bytes that the files of a policy folder hold."""
    return sum(path.stat().st_size for path in folder.iterdir())


def load_policy(name_or_path: str | Path) -> Policy:
    """Load a policy that ships, by name, or a policy or run folder, by path. Runs no code from it.

    InputError in one sentence for a name nobody knows, and for a folder that is not a whole, sound policy.
    """
    return read_policy(find_policy(name_or_path))


def read_policy(folder: Path) -> Policy:
    """Read a policy folder; InputError in one sentence if it is not whole and sound."""
    card = read_card(folder / CARD_FILE)
    return Policy(_read_weights(folder / WEIGHTS_FILE, card), card)


def save_policy(folder: Path, weights: Mapping[str, NDArray[np.floating]], card: PolicyCard) -> None:
    """Write a policy folder, whole or not at all; a policy that is there already is replaced.

    `weights` are named and shaped as `Policy` takes them, float32 or float16. InputError if they don't
    fit the card, or if `folder` holds anything but a policy.
    """
    _check_weights(weights, card, "weights")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: this is a file; a policy is written to a folder.")
    if folder.is_dir() and (strange := {path.name for path in folder.iterdir()} - {WEIGHTS_FILE, CARD_FILE}):
        raise InputError(f"{folder}: holds {min(strange)!r}, so it is not replaced by a policy.")
    parent = folder.absolute().parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
        # Beside the target, since a rename is atomic within one file system only.
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=parent) as scratch:
            fresh, former = Path(scratch) / "new", Path(scratch) / "old"
            fresh.mkdir()
            whole = {name: np.ascontiguousarray(array) for name, array in weights.items()}
            # Not by save_file, which lets nobody but the owner read the file.
            (fresh / WEIGHTS_FILE).write_bytes(safetensors.numpy.save(whole))
            (fresh / CARD_FILE).write_text(card_text(card), encoding="utf-8")
            if folder.exists():
                folder.rename(former)
            fresh.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: the policy cannot be written: {error.strerror or error}.") from error


def find_policy(name_or_path: str | Path, scripted: Iterable[str] = ()) -> Path:
    """Return the folder of a policy that ships, by name, or else of a policy or run folder, by path.

    InputError for what is none, with the nearest names; `scripted` are names that would also have done.
    """
    text = os.fspath(name_or_path)
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
        raise InputError(f"no policy is named {text[:200]!r}, and there is no such folder{near}")
    if not is_folder:
        raise InputError(f"{path}: this is a file; give the policy's folder.")
    for folder in (path, path / RUN_POLICY):
        if (folder / CARD_FILE).exists() or (folder / WEIGHTS_FILE).exists():
            return folder
    raise InputError(
        f"{path}: neither a policy folder ({CARD_FILE} and {WEIGHTS_FILE}) nor a run folder ({RUN_POLICY}/)."
    )


def _read_weights(path: Path, card: PolicyCard) -> dict[str, NDArray[np.floating]]:
    numbers = sum((inputs + 1) * outputs for inputs, outputs in card.layers)
    if 4 * numbers * card.robots > _MOST_BYTES:
        raise InputError(
            f"{path}: {card.robots} networks of {numbers} numbers need more than {_MOST_BYTES} bytes, "
            "the most a policy may take."
        )
    data = read_limited(path, 4 * numbers * card.networks + _MOST_HEADER)
    try:
        tensors: list[tuple[str, dict[str, Any]]] = safetensors.deserialize(data)  # type: ignore[no-untyped-call]
    except safetensors.SafetensorError as error:
        raise InputError(f"{path}: not a whole safetensors file ({error}).") from None
    weights: dict[str, NDArray[np.floating]] = {}
    for name, tensor in tensors:
        dtype = _DTYPES.get(tensor["dtype"])
        if dtype is None:
            raise InputError(f"{path}: {name[:60]!r} is of type {tensor['dtype']}: it must be F32 or F16.")
        weights[name] = np.frombuffer(tensor["data"], dtype).reshape(tensor["shape"])
    _check_weights(weights, card, str(path))
    return weights


def _check_weights(weights: Mapping[str, NDArray[np.floating]], card: PolicyCard, place: str) -> None:
    expected: dict[str, tuple[int, ...]] = {}
    for layer, (inputs, outputs) in enumerate(card.layers):
        expected[f"layer{layer}.weight"] = (card.networks, inputs, outputs)
        expected[f"layer{layer}.bias"] = (card.networks, outputs)
    for name in sorted(expected.keys() | weights.keys()):
        if name not in weights:
            raise InputError(f"{place}: tensor {name!r} is missing.")
        if name not in expected:
            raise InputError(f"{place}: tensor {name[:60]!r} is not one of {len(card.layers)} layers.")
        array = weights[name]
        if array.shape != expected[name]:
            raise InputError(f"{place}: {name!r} has shape {array.shape}; the card says {expected[name]}.")
        if array.dtype not in _DTYPES.values():
            raise InputError(f"{place}: {name!r} is of type {array.dtype}: it must be float32 or float16.")
        if card.network.precision not in (None, array.dtype.name):
            raise InputError(
                f"{place}: {name!r} is of type {array.dtype}; the card says {card.network.precision}."
            )
        if not np.isfinite(array).all():
            raise InputError(f"{place}: {name!r} holds a number that is not finite.")
