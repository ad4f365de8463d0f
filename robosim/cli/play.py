"""`robosim play`: run one episode, or run one again, and record it for the viewer."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from robosim.playback.episode import OnStep, Recorded


@dataclass(frozen=True)
class Play:
    """Run one episode, or a saved one again, and record it, to be looked at in the rerun viewer."""

    policy: Annotated[str, tyro.conf.Positional]
    """Trained policy by name, policy or run folder, scripted controller by name, or a saved trajectory (.npz)
    to run again."""
    arena: str | None = None
    """Arena by name, or the path of its file; by default the one a policy learned in, or `paper`."""
    robots: int | None = None
    """Team size; by default a policy's own, or 4."""
    steps: int | None = None
    """Decisions to record; by default a whole episode, as long as the arena or the trajectory says."""
    seed: int | None = None
    """Root of all randomness; by default 0."""
    save: Path = Path("run.rrd")
    """The recording to write."""
    save_trajectory: Annotated[Path | None, tyro.conf.arg(metavar="RUN.npz")] = None
    """Keep the episode as seed and actions too: a small file that `robosim play` can run again."""
    view: bool = False
    """Open the recording in the viewer when it is done."""

    def run(self) -> None:
        """Record, and say where the recording is and how to open it."""
        from robosim.envs.trajectory import SUFFIX
        from robosim.errors import InputError

        if self.steps is not None and self.steps < 1:
            raise InputError(f"--steps is {self.steps}: it must be at least 1.")
        if self.seed is not None and self.seed < 0:
            raise InputError(f"--seed is {self.seed}: it must not be negative.")
        wanted, recorded = self._run_again() if Path(self.policy).suffix == SUFFIX else self._run_policy()
        print(
            f"{self.save}: {recorded.decisions} decisions, {recorded.delivered} pellets, "
            f"{self.save.stat().st_size / 1e6:.1f} MB\nopen it with: rerun {self.save}"
        )
        if recorded.decisions < wanted:
            raise KeyboardInterrupt
        if self.view:
            # By module, since the viewer's command need not be on the path.
            viewer = [sys.executable, "-m", "rerun", str(self.save.resolve())]
            subprocess.Popen(viewer, start_new_session=True)  # noqa: S603  # our own interpreter, an absolute path

    def _run_policy(self) -> tuple[int, Recorded]:
        """Return the decisions wanted, and what was recorded."""
        from robosim.control.controller import make_controller
        from robosim.control.environment import environment_for
        from robosim.envs.trajectory import require_place
        from robosim.playback.episode import record_episode

        if self.save_trajectory is not None:
            require_place(self.save_trajectory)
        seed = self.seed or 0
        controller = make_controller(self.policy)
        env = environment_for(
            controller, self.arena, self.robots, seed=seed, episode_steps=self.steps, autoreset=False
        )
        about = {"policy": self.policy, "seed": str(seed)}
        with _show_progress(env.episode_steps) as on_step:
            recorded = record_episode(controller, env, self.save, about=about, on_step=on_step)
        if self.save_trajectory is not None:
            env.trajectory(policy=self.policy).save(self.save_trajectory)
            print(f"{self.save_trajectory}: run it again with: robosim play {self.save_trajectory}")
        return env.episode_steps, recorded

    def _run_again(self) -> tuple[int, Recorded]:
        """Return the decisions wanted, and what was recorded."""
        from robosim.envs.trajectory import load_trajectory
        from robosim.errors import InputError
        from robosim.playback.episode import record_trajectory

        for option in ("arena", "robots", "seed", "save_trajectory"):
            if getattr(self, option) is not None:
                raise InputError(
                    f"--{option.replace('_', '-')} cannot be given with {self.policy}: "
                    "a trajectory runs again just as it was."
                )
        trajectory = load_trajectory(self.policy)
        length = len(trajectory.chosen)
        wanted = length if self.steps is None else self.steps
        if wanted > length:
            raise InputError(f"--steps is {wanted}: {self.policy} holds {length} decisions.")
        about = {
            "policy": trajectory.policy or "unknown",
            "trajectory": Path(self.policy).name,
            "environment_seed": str(trajectory.seed),
            "episode": str(trajectory.episode),
        }
        with _show_progress(wanted) as on_step:
            recorded = record_trajectory(
                replace(trajectory, chosen=trajectory.chosen[:wanted]),
                self.save,
                about=about,
                on_step=on_step,
                source=self.policy,
            )
        return wanted, recorded


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
