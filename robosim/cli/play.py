"""`robosim play`: run one episode and record it for the viewer."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from robosim.playback.episode import OnStep


@dataclass(frozen=True)
class Play:
    """Run one episode and record it, to be looked at in the rerun viewer."""

    policy: Annotated[str, tyro.conf.Positional]
    """Trained policy by name, policy or run folder, or scripted controller by name."""
    arena: str | None = None
    """Arena by name, or the path of its file; by default the one a policy learned in, or `paper`."""
    robots: int | None = None
    """Team size; by default a policy's own, or 4."""
    steps: int | None = None
    """Decisions to record; by default a whole episode, as long as the arena says."""
    seed: int = 0
    """Root of all randomness."""
    save: Path = Path("run.rrd")
    """The recording to write."""
    view: bool = False
    """Open the recording in the viewer when it is done."""

    def run(self) -> None:
        """Record, and say where the recording is and how to open it."""
        from robosim.control.controller import make_controller
        from robosim.control.environment import environment_for
        from robosim.errors import InputError
        from robosim.playback.episode import record_episode

        if self.steps is not None and self.steps < 1:
            raise InputError(f"--steps is {self.steps}: it must be at least 1.")
        if self.seed < 0:
            raise InputError(f"--seed is {self.seed}: it must not be negative.")
        controller = make_controller(self.policy)
        env = environment_for(
            controller,
            self.arena,
            self.robots,
            seed=self.seed,
            episode_steps=self.steps,
            autoreset=False,
        )
        about = {"policy": self.policy, "seed": str(self.seed)}
        with _show_progress(env.episode_steps) as on_step:
            taken = record_episode(controller, env, self.save, about=about, on_step=on_step)
        print(
            f"{self.save}: {taken} decisions, {int(env.delivered.sum())} pellets, "
            f"{self.save.stat().st_size / 1e6:.1f} MB\nopen it with: rerun {self.save}"
        )
        if taken < env.episode_steps:
            raise KeyboardInterrupt
        if self.view:
            # By module, since the viewer's command need not be on the path.
            viewer = [sys.executable, "-m", "rerun", str(self.save.resolve())]
            subprocess.Popen(viewer, start_new_session=True)  # noqa: S603  # our own interpreter, an absolute path


@contextlib.contextmanager
def _show_progress(steps: int) -> Iterator[OnStep]:
    """Yield what shows the decisions taken: a bar in a terminal, ten lines in a pipe."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console()
    started = time.perf_counter()
    every = max(1, steps // (200 if console.is_terminal else 10))

    def figures(step: int, delivered: int) -> str:
        return f"{delivered} pellets  {step / (time.perf_counter() - started):.0f} steps/s"

    if not console.is_terminal:

        def print_line(step: int, delivered: int) -> None:
            if step % every == 0 or step == steps:
                print(f"step {step}/{steps}  {figures(step, delivered)}", flush=True)

        yield print_line
        return

    columns = (
        TextColumn("recording"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f}  {task.fields[figures]}  left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("", total=steps, figures="")

        def move_bar(step: int, delivered: int) -> None:
            if step % every == 0 or step == steps:
                bar.update(task, completed=step, figures=figures(step, delivered))

        yield move_bar
