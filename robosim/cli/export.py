"""`robosim export`: a policy as a file that other programs run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from robosim.deploy.export import Agreement

SUFFIX = ".onnx"
MOST_OBSERVATIONS = 1_000_000


@dataclass(frozen=True)
class Export:
    """Write a trained policy as one ONNX file: networks, normalisation, mask, and the choice of actions."""

    policy: Annotated[str, tyro.conf.Positional]
    """Trained policy by name, or policy or run folder."""
    onnx: Annotated[Path | None, tyro.conf.arg(metavar="FILE.onnx")] = None
    """The file to write."""
    observations: int = 1000
    """Observations of the team at work on which onnxruntime must choose as robosim does, or nothing is
    written."""

    def run(self) -> None:
        """Export, compare, write, and say what has been compared."""
        from robosim.control.controller import SCRIPTED
        from robosim.control.policy import find_policy, read_policy
        from robosim.errors import InputError, whole_number
        from robosim.files import require_writable, write_whole

        if self.onnx is None:
            raise InputError("nothing to export to: give --onnx FILE.onnx.")
        if self.onnx.suffix != SUFFIX:
            raise InputError(f"{self.onnx}: cannot be written: the name of the file must end in {SUFFIX}.")
        whole_number("--observations", self.observations, 1, MOST_OBSERVATIONS)
        if self.policy in SCRIPTED:
            raise InputError(f"{self.policy!r} is a scripted controller: it has no networks to export.")
        folder = find_policy(self.policy)
        policy = read_policy(folder)
        require_writable(self.onnx)
        # Now, since it needs what need not be installed.
        from robosim.deploy.export import agreement, onnx_model, real_observations
        from robosim.deploy.runtime import OnnxPolicy

        name = Path(self.policy).name
        model = onnx_model(folder, name)
        seen = real_observations(policy, name, self.observations)
        found = agreement(OnnxPolicy(model), policy, seen)
        if not found.holds:
            raise RuntimeError(f"onnxruntime does not agree with robosim: {found}")
        write_whole(self.onnx, model)
        self._say_done(found, len(model))

    def _say_done(self, found: Agreement, size: int) -> None:
        print(f"{self.onnx}: {size / 1e6:.2f} MB\nonnxruntime and robosim: {found}")
