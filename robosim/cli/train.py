"""`robosim train`: teams learn, and leave a run folder."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from robosim.errors import InputError
from robosim.learning.config import TrainConfig

if TYPE_CHECKING:
    from robosim.control.learned import LearnedController
    from robosim.envs.vector import VectorEnv


@dataclass(frozen=True)
class Train:
    """Let a team of robots learn, and keep the run in a folder: policy, metrics, config, evaluation."""

    config: TrainConfig = field(default_factory=TrainConfig)
    """What to train, and how."""
    out: Path | None = None
    """New or empty folder for the run; by default runs/ARENA-ROBOTS-TECHNIQUE-SEED."""
    resume: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """Folder of an interrupted run to go on with, just as it was configured."""

    def run(self) -> None:
        """Train with a progress display, then say what came of it."""
        from robosim.learning.config import read_config
        from robosim.learning.progress import show_progress
        from robosim.learning.trainer import CONFIG_FILE, resume, train

        folder = self._folder()
        config = self.config
        if self.resume is not None and (folder / CONFIG_FILE).is_file():
            config = read_config(folder / CONFIG_FILE)
        try:
            with show_progress(config.steps) as report:
                if self.resume is None:
                    command = shlex.join(["robosim", *sys.argv[1:]])[:2000]
                    result = train(config, folder, report, command, _record)
                else:
                    result = resume(folder, report, _record, _warn)
        except KeyboardInterrupt:
            if (folder / CONFIG_FILE).exists():
                print(f"Stopped; go on with: robosim train --resume {shlex.quote(str(folder))}")
            raise
        print(f"{config.steps} joint decisions in {result.wall_time:.0f} s; run folder {folder}")
        if result.evaluation is not None:
            from robosim.cli.evaluate import summary

            print(summary(result.evaluation))

    def _folder(self) -> Path:
        config = self.config
        if self.resume is None:
            name = f"{Path(config.arena).stem}-{config.robots}-{config.technique}-{config.seed}"
            return self.out or Path("runs") / name
        changed = [one.name for one in fields(config) if getattr(config, one.name) != one.default]
        if self.out is not None:
            changed.append("out")
        if changed:
            raise InputError(
                f"--resume goes on with a run as it was configured: --{changed[0].replace('_', '-')} "
                "cannot be given with it."
            )
        return self.resume


def _record(controller: LearnedController, env: VectorEnv, path: Path) -> None:
    from robosim.playback.episode import record_episode

    env.autoreset = False
    record_episode(controller, env, path, about={"policy": controller.name})


def _warn(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)
