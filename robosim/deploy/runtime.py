"""An exported policy, run by onnxruntime: what a computer needs that has onnxruntime and not onnx."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from robosim.control.card import PolicyCard
from robosim.control.network import draws
from robosim.errors import InputError

OBSERVATION, DRAWS, ACTIONS, VALUES = "observation", "draws", "actions", "values"
"""Names of the graph's inputs and outputs; `draws` is there only where actions are drawn."""

Floats = NDArray[np.float32]


class OnnxPolicy:
    """An exported policy, run by onnxruntime on one thread."""

    def __init__(self, model: bytes | str | Path) -> None:
        """Take the file's bytes or its path; InputError for a file that onnxruntime does not take."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._place = "model" if isinstance(model, bytes) else str(model)
        source = model if isinstance(model, bytes) else str(model)
        try:
            self._session = onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # noqa: BLE001  its own errors have no class in common
            said = " ".join(str(error).split()).rstrip(".")
            raise InputError(f"{self._place}: onnxruntime cannot run it: {said}.") from None

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of itself."""
        return dict(self._session.get_modelmeta().custom_metadata_map)

    @cached_property
    def card(self) -> PolicyCard:
        """The policy's card; InputError for a file that robosim has not exported."""
        try:
            table = json.loads(self.metadata["card"])
        except (KeyError, ValueError, RecursionError):
            table = None
        if not isinstance(table, dict):
            raise InputError(f"{self._place}: its metadata hold no card, so robosim has not exported it.")
        return PolicyCard.from_table(table, f"{self._place}: card")

    def run(self, observation: Floats, decision: int | None = None) -> tuple[NDArray[np.int64], Floats]:
        """Return actions [batch, robots] and values for observations [batch, robots, size].

        A policy that draws its actions needs the number of the `decision`; InputError where that is missing.
        """
        inputs = {OBSERVATION: observation}
        if any(one.name == DRAWS for one in self._session.get_inputs()):
            if decision is None:
                raise InputError(
                    f"{self._place}: decision is missing, but must be the number of the decision in the "
                    "episode: this policy draws its actions."
                )
            inputs[DRAWS] = draws(decision, observation.shape[:-1])
        actions, values = self._session.run([ACTIONS, VALUES], inputs)
        return actions, values

    def act(self, observation: Floats, decision: int | None = None) -> NDArray[np.int64]:
        """Return the actions [batch, robots] for observations [batch, robots, size]; as `run` otherwise."""
        return self.run(observation, decision)[0]
