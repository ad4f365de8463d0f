"""`robosim train`: teams learn, and leave a run folder."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path

from robosim.learning.config import TrainConfig


@dataclass(frozen=True)
class Train:
    """Let a team of robots learn, and keep the run in a folder: policy, metrics, config, evaluation."""

    config: TrainConfig = field(default_factory=TrainConfig)
    """What to train, and how."""
    out: Path | None = None
    """New or empty folder for the run; by default runs/ARENA-ROBOTS-TECHNIQUE-SEED."""

    def run(self) -> None:
        """Train with a progress display, then say what came of it."""
        from robosim.learning.progress import show_progress
        from robosim.learning.trainer import train

        config = self.config
        name = f"{Path(config.arena).stem}-{config.robots}-{config.technique}-{config.seed}"
        folder = self.out or Path("runs") / name
        command = shlex.join(["robosim", *sys.argv[1:]])[:2000]
        try:
            with show_progress(config.steps) as report:
                result = train(config, folder, report, command)
        except KeyboardInterrupt:
            print(f"Stopped; the policy learned so far is in {folder / 'policy'}.")
            raise
        print(f"{config.steps} joint decisions in {result.wall_time:.0f} s; run folder {folder}")
        if result.evaluation is not None:
            from robosim.cli.evaluate import summary

            print(summary(result.evaluation))
