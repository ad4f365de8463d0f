"""An exported policy, run by onnxruntime: what a computer needs that has onnxruntime and not onnx."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from robosim.control.card import PolicyCard
from robosim.control.network import draws
from robosim.control.retreat import checked_retreats
from robosim.errors import InputError, shown
from robosim.texts import parse_json, read_limited

OBSERVATION, DRAWS, ACTIONS, VALUES = "observation", "draws", "actions", "values"
"""Names of the graph's inputs and outputs; `draws` is there only where actions are drawn."""
RETREATS, RETREATS_LEFT = "retreats", "retreats_left"
"""Names of an input and an output that are there only where robots retreat."""
MOST_BYTES = 2**28
"""Of a file; the largest policy that ships takes 2 MB."""

_Ports = dict[str, tuple[str, int | None]]
_INPUTS: _Ports = {
    OBSERVATION: ("tensor(float)", 3),
    DRAWS: ("tensor(float)", 2),
    RETREATS: ("tensor(int64)", 2),
}
_OUTPUTS: _Ports = {
    ACTIONS: ("tensor(int64)", 2),
    VALUES: ("tensor(float)", None),
    RETREATS_LEFT: ("tensor(int64)", 2),
}
"""Type and dimensions of each; values have as many as their head."""

Floats = NDArray[np.float32]
Whole = NDArray[np.int64]


class OnnxPolicy:
    """An exported policy, run by onnxruntime on one thread."""

    def __init__(self, model: bytes | str | Path) -> None:
        """Take the file's bytes or its path.

        InputError for a file that onnxruntime does not take, or that robosim cannot have exported. Nothing
        but the file is read: weights in files beside it are refused.
        """
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        # What is wrong is said here, in a sentence.
        options.log_severity_level = 4
        self._place = "model" if isinstance(model, bytes) else str(model)
        data = model if isinstance(model, bytes) else read_limited(Path(model), MOST_BYTES, "ONNX file")
        try:
            # Otherwise it tries what has failed a second time, and says so on the standard output.
            self._session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"], enable_fallback=0
            )
            # Names in it may be no text.
            self.metadata = dict(self._session.get_modelmeta().custom_metadata_map)
            """What the file says of itself."""
            self._size = self._check_graph()
            names = {one.name for one in self._session.get_inputs()}
            self._draws, self._remembers = (name in names for name in (DRAWS, RETREATS))
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001  its own errors have no class in common
            raise InputError(f"{self._place}: onnxruntime cannot run it: {_said(error)}.") from None

    @cached_property
    def card(self) -> PolicyCard:
        """The policy's card; InputError for a file that robosim has not exported."""
        try:
            table = parse_json(self.metadata["card"])
        except (KeyError, ValueError):
            table = None
        if not isinstance(table, dict):
            raise InputError(f"{self._place}: its metadata hold no card, so robosim has not exported it.")
        card = PolicyCard.from_table(table, f"{self._place}: card")
        if len(card.observation) != self._size:
            raise InputError(
                f"{self._place}: its card has observations of {len(card.observation)} numbers, but its graph "
                f"of {self._size}."
            )
        return card

    def run(
        self, observation: Floats, decision: int | None = None, retreats: Whole | None = None
    ) -> tuple[Whole, Floats]:
        """Return actions [batch, robots] and values for observations [batch, robots, size].

        A policy that draws its actions needs the number of the `decision`, and one whose robots retreat
        `retreats` [batch, robots], which it changes, as `robosim.control.policy.Policy.act` does; InputError
        where that is missing or another, and for a graph that fails.
        """
        inputs: dict[str, NDArray[Any]] = {OBSERVATION: observation}
        if self._draws:
            if decision is None:
                raise InputError(
                    f"{self._place}: decision is missing, but must be the number of the decision in the "
                    "episode: this policy draws its actions."
                )
            inputs[DRAWS] = draws(decision, observation.shape[:-1])
        if self._remembers:
            inputs[RETREATS] = checked_retreats(retreats, observation.shape[:-1], f"{self._place}: ")
        shape = list(observation.shape)
        outputs = [ACTIONS, VALUES, *([RETREATS_LEFT] if self._remembers else [])]
        try:
            actions, values, *left = self._session.run(outputs, inputs)
        except Exception as error:  # noqa: BLE001  its own errors have no class in common
            raise InputError(
                f"{self._place}: onnxruntime cannot run it on observations {shape}: {_said(error)}."
            ) from None
        if list(actions.shape) != shape[:2]:
            raise InputError(
                f"{self._place}: chooses actions {list(actions.shape)} for observations {shape}, but must "
                f"choose {shape[:2]}."
            )
        if retreats is not None and left:
            retreats[...] = left[0]
        return actions, values

    def act(self, observation: Floats, decision: int | None = None, retreats: Whole | None = None) -> Whole:
        """Return the actions [batch, robots] for observations [batch, robots, size].

        As `run` otherwise; InputError, too, for actions that the policy's card does not know.
        """
        actions = self.run(observation, decision, retreats)[0]
        most = self.card.network.actions - 1
        # As numbers without sign, those below 0 are large.
        if actions.view(np.uint64).max(initial=0) > most:
            wrong = shown(actions.ravel().tolist())
            raise InputError(f"{self._place}: chooses actions {wrong}, but must choose from 0 to {most}.")
        return actions

    def _check_graph(self) -> int:
        """Return how many numbers an observation has; InputError unless inputs and outputs are a policy's."""
        found = self._session.get_inputs(), self._session.get_outputs()
        memory = {RETREATS_LEFT} if RETREATS in {one.name for one in found[0]} else set()
        for what, ports, known, needed in (
            ("inputs", found[0], _INPUTS, {OBSERVATION}),
            ("outputs", found[1], _OUTPUTS, {ACTIONS, VALUES} | memory),
        ):
            names = {one.name for one in ports}
            wrong = [one.name for one in ports if not _fits(one, known)]
            if wrong or not needed <= names:
                raise InputError(
                    f"{self._place}: is no policy that robosim has exported: its {what} are "
                    f"{shown([f'{one.name} {one.type} {one.shape}' for one in ports])}."
                )
        size = next(one.shape[2] for one in found[0] if one.name == OBSERVATION)
        return size if isinstance(size, int) else 0


def _fits(port: Any, known: _Ports) -> bool:
    kind, dimensions = known.get(port.name, ("", None))
    return port.type == kind and dimensions in (None, len(port.shape))


def _said(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".")
