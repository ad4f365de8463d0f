"""`robosim export`: a policy as a file that other programs run, or as an experiment of the Robotarium."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

SUFFIX = ".onnx"
MOST_OBSERVATIONS = 1_000_000
MOST_SEED = 2**63 - 1


@dataclass(frozen=True)
class Export:
    """Write a trained policy for other programs: as one ONNX file, or as a folder for the Robotarium.

    The file holds networks, normalisation, mask, and the choice of actions. The folder holds an experiment of
    that laboratory, flat files that need numpy alone: main.py is run there, or in its public simulator.
    """

    policy: Annotated[str, tyro.conf.Positional]
    """Trained policy by name, or policy or run folder."""
    onnx: Annotated[Path | None, tyro.conf.arg(metavar="FILE.onnx")] = None
    """The file to write."""
    observations: int = 1000
    """Observations of the team at work on which onnxruntime must choose as robosim does, or no file is
    written."""
    robotarium: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """The folder to write, which must be empty or not there."""
    seconds: float = 900.0
    """How long the Robotarium's robots are to work; it allows 900."""
    barrier: float = 0.15
    """Distance that the Robotarium's barrier certificates keep between robots, m; 0 for none, but it refuses
    experiments in which robots come nearer than 0.135."""
    seed: int = 0
    """Of where the Robotarium's robots begin and its virtual pellets lie."""

    def run(self) -> None:
        """Export, compare, write, and say what has been compared."""
        from robosim.control.controller import SCRIPTED
        from robosim.control.policy import find_policy
        from robosim.errors import InputError, whole_number

        if self.onnx is None and self.robotarium is None:
            raise InputError("nothing to export to: give --onnx FILE.onnx or --robotarium FOLDER.")
        if self.onnx is not None and self.onnx.suffix != SUFFIX:
            raise InputError(f"{self.onnx}: cannot be written: the name of the file must end in {SUFFIX}.")
        whole_number("--observations", self.observations, 1, MOST_OBSERVATIONS)
        whole_number("--seed", self.seed, 0, MOST_SEED)
        if self.policy in SCRIPTED:
            raise InputError(f"{self.policy!r} is a scripted controller: it has no networks to export.")
        folder, name = find_policy(self.policy), Path(self.policy).name
        if self.onnx is not None:
            self._write_onnx(folder, name, self.onnx)
        if self.robotarium is not None:
            self._write_robotarium(folder, name, self.robotarium)

    def _write_onnx(self, folder: Path, name: str, path: Path) -> None:
        from robosim.control.policy import read_policy
        from robosim.files import require_writable, write_whole

        policy = read_policy(folder)
        require_writable(path)
        # Now, since it needs what need not be installed.
        from robosim.deploy.export import agreement, onnx_model, real_observations
        from robosim.deploy.runtime import OnnxPolicy

        model = onnx_model(folder, name)
        seen = real_observations(policy, name, self.observations)
        found = agreement(OnnxPolicy(model), policy, seen)
        if not found.holds:
            raise RuntimeError(f"onnxruntime does not agree with robosim: {found}")
        write_whole(path, model)
        print(f"{path}: {len(model) / 1e6:.2f} MB\nonnxruntime and robosim: {found}")

    def _write_robotarium(self, folder: Path, name: str, path: Path) -> None:
        from robosim.analysis.report.folder import whole_folder
        from robosim.deploy.robotarium.export import robotarium_files

        files = robotarium_files(folder, name, seconds=self.seconds, apart=self.barrier, seed=self.seed)
        with whole_folder(path, "script") as part:
            for file, data in files.items():
                (part / file).write_bytes(data)
        size = sum(map(len, files.values()))
        print(f"{path}: {len(files)} files, {size / 1e6:.2f} MB; main.py is the one to run")
