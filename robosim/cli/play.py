"""`robosim play`: run one episode, or run one again, and record it for the viewer."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from robosim.cli.program import hint

if TYPE_CHECKING:
    from robosim.analysis.clogs.clog import Clog
    from robosim.arena.model import Arena
    from robosim.control.controller import Controller
    from robosim.envs.vector import VectorEnv
    from robosim.episodes.frame import Frame
    from robosim.episodes.trajectory import Trajectory
    from robosim.playback.episode import FoundClogs, OnStep, Recorded

_OF_LOGS = {"policy", "save", "steps", "view"}
"""Options that go with a log."""
AROUND = 5.0
"""Time before and after a clog that `--clogs-only` records, s."""
LONGEST_AROUND = 1e9
"""Longest such time, s: more than any episode lasts."""


@dataclass(frozen=True)
class Play:
    """Run one episode, or a saved one again, and record it for the rerun viewer, or film it."""

    policy: Annotated[str, tyro.conf.Positional] = "any"
    """Trained policy by name, policy or run folder, scripted controller by name, a saved trajectory (.npz) to
    run again, or the log of a controller of real robots (.jsonl) to show; by default `any`, one network for
    teams of 1 to 32 robots in any arena of its robot."""
    arena: str | None = None
    """Arena by name, or the path of its file; by default the one a policy learned in, or `paper`."""
    robots: int | None = None
    """Team size; by default a policy's own, or 4."""
    world: Literal["physics", "grid"] | None = None
    """Rigid bodies, or one robot a cell; by default the world that a policy learned in, or `physics`."""
    profile: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE.toml")] = None
    """What is random and wrong about robots and what they perceive, by name or file (docs/noise.md); by
    default nothing, whatever profile a policy learned under."""
    odometry: Annotated[float | None, tyro.conf.arg(metavar="WEIGHT")] = None
    """Robots go on from their fixes by the turns of their wheels, as in `evaluate`."""
    steps: int | None = None
    """Decisions to record; by default a whole episode, as long as the arena or the trajectory says."""
    seed: int | None = None
    """Root of all randomness; by default 0."""
    save: Annotated[Path | None, tyro.conf.arg(metavar="RUN.rrd")] = None
    """The recording to write; by default run.rrd, or run-2.rrd and so on where that is there already, and
    none where --video alone is asked for."""
    video: Annotated[Path | None, tyro.conf.arg(metavar="RUN.mp4|.webp|.gif")] = None
    """Film the episode: MP4 for slides, animated WebP or GIF for pages."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="NUMBER")] = None
    """How many times as fast as it happened the film shows it, by default 1; or `--live`, by default as
    fast as it can be worked out."""
    size: Annotated[int | None, tyro.conf.arg(metavar="PIXELS")] = None
    """Longer side of the film's pictures, about; by default 960."""
    save_trajectory: Annotated[Path | None, tyro.conf.arg(metavar="RUN.npz")] = None
    """Keep the episode as seed and actions too: a small file that `robosim play` can run again."""
    clogs_only: bool = False
    """Run twice: watch for clogs first, then record only them and a little before and after each. Without a
    clog nothing is recorded."""
    around: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """Simulated time before and after each clog that `--clogs-only` records; by default 5."""
    view: bool = False
    """Open the recording in the viewer when it is done; without a display a browser shows it."""
    live: bool = False
    """Show the episode in the viewer while it runs, and record it; without a display a browser shows it."""

    def run(self) -> None:
        """Record, and say where the recording is and how to open it."""
        from robosim.envs.config import MOST_STEPS
        from robosim.envs.vector import MAX_SEED
        from robosim.episodes.control_frame import LOG_SUFFIX
        from robosim.episodes.trajectory import SUFFIX
        from robosim.errors import whole_number

        if self.steps is not None:
            whole_number("--steps", self.steps, 1, MOST_STEPS)
        if self.seed is not None:
            whole_number("--seed", self.seed, 0, MAX_SEED)
        self._check_around()
        self._check_film()
        placed = replace(self, save=self._place())
        if Path(self.policy).suffix == LOG_SUFFIX:
            placed._run_log()
            return
        again = Path(self.policy).suffix == SUFFIX
        if self.clogs_only:
            recorded = placed._run_clogs(again)
        else:
            recorded = placed._run_again() if again else placed._run_policy()
        if recorded and self.view:
            from robosim.cli.view import View

            View(placed.recording).run()

    def _place(self) -> Path | None:
        """Return where the recording goes, None if there is to be none."""
        if self.save is not None or (self.video is not None and not self.view and not self.live):
            return self.save
        names = chain(["run.rrd"], (f"run-{number}.rrd" for number in count(2)))
        return next(Path(name) for name in names if not Path(name).exists())

    @property
    def recording(self) -> Path:
        """Where the recording goes."""
        assert self.save is not None  # noqa: S101  # who asks has made sure, which mypy cannot know
        return self.save

    def _check_around(self) -> None:
        from robosim.errors import InputError, refused

        if self.around is None:
            return
        if not self.clogs_only:
            raise InputError("--around says how much to record around clogs: it needs --clogs-only.")
        if not 0.0 <= self.around <= LONGEST_AROUND:
            raise refused("--around", self.around, f"a number of seconds from 0 to {LONGEST_AROUND:g}")

    def _check_film(self) -> None:
        from robosim.analysis.film import LONG_SIDES, SPEEDS
        from robosim.errors import InputError, refused, whole_number

        if self.speed is not None:
            if self.video is None and not self.live:
                raise InputError("--speed says how fast a film is: it needs --video or --live.")
            if not SPEEDS[0] <= self.speed <= SPEEDS[1]:
                raise refused("--speed", self.speed, f"a number from {SPEEDS[0]:g} to {SPEEDS[1]:g}")
        if self.size is not None:
            if self.video is None:
                raise InputError("--size says how large a film is: it needs --video.")
            whole_number("--size", self.size, *LONG_SIDES)
        for option in ("video", "live"):
            if self.clogs_only and getattr(self, option):
                raise InputError(f"--{option} shows an episode whole: it cannot be given with --clogs-only.")
        if self.live and self.view:
            raise InputError("--live opens the viewer while the episode runs: --view is not needed with it.")

    def _say_done(self, what: str, complete: bool) -> None:
        size = self.recording.stat().st_size / 1e6
        print(f"{self.save}: {what}, {size:.1f} MB\nopen it with: {hint('view', self.recording)}", flush=True)
        if not complete:
            raise KeyboardInterrupt

    def _say_recorded(self, recorded: Recorded, wanted: int) -> None:
        what = f"{recorded.decisions} decisions, {recorded.delivered} pellets"
        self._say_done(what, recorded.decisions == wanted)

    def _run_policy(self) -> bool:
        controller, env = self._team()
        self._require_film(env.arena, env.episode_steps)
        if self.save is None:
            from robosim.analysis.film import driven

            self._film(driven(controller, env), env.arena, env.episode_steps)
            self._save_trajectory(env.trajectory(policy=self.policy))
            return False
        from robosim.playback.episode import record_episode

        with self._viewer() as viewer, self._progress(env.episode_steps, env.arena) as on_step:
            recorded = record_episode(
                controller,
                env,
                self.save,
                about=self._about(env.config.world),
                on_step=on_step,
                viewer=viewer,
            )
            trajectory = env.trajectory(policy=self.policy)
            self._save_trajectory(trajectory)
            self._say_recorded(recorded, env.episode_steps)
        self._film_again(trajectory)
        return True

    def _run_again(self) -> bool:
        from robosim.episodes.replay import begun

        trajectory = self._load()
        wanted = len(trajectory.chosen)
        arena = begun(trajectory, self.policy).arena
        self._require_film(arena, wanted)
        if self.save is None:
            self._film_again(trajectory)
            return False
        from robosim.playback.episode import record_trajectory

        with self._viewer() as viewer, self._progress(wanted, arena) as on_step:
            recorded = record_trajectory(
                trajectory,
                self.save,
                about=self._about(trajectory.config.world, trajectory),
                on_step=on_step,
                viewer=viewer,
                source=self.policy,
            )
            self._say_recorded(recorded, wanted)
        self._film_again(trajectory)
        return True

    @contextlib.contextmanager
    def _viewer(self) -> Iterator[str]:
        """Give the URL of a viewer, if one is to show the episode while it runs."""
        if not self.live:
            yield ""
            return
        from robosim.cli.view import say
        from robosim.playback.file import require_recording
        from robosim.playback.viewer import live_viewer

        require_recording(self.recording)
        with live_viewer(say, lingers=True) as viewer:
            yield viewer

    @contextlib.contextmanager
    def _progress(self, steps: int, arena: Arena) -> Iterator[OnStep]:
        """Yield what shows the decisions taken, and holds an episode that is watched to its pace."""
        with _show_progress(steps) as on_step:
            if self.live and self.speed is not None:
                yield _paced(on_step, arena.timing.decision_period / self.speed)
            else:
                yield on_step

    def _require_film(self, arena: Arena, decisions: int) -> None:
        """Say now, before the episode runs, what would keep it from being filmed."""
        if self.video is not None:
            from robosim.analysis.film import Pace, require_film

            require_film(self.video, Pace.of(arena, self.speed or 1.0).pictures(decisions))

    def _film_again(self, trajectory: Trajectory) -> None:
        """Film a trajectory, if there is to be a film."""
        if self.video is not None:
            from robosim.episodes.replay import begun, replay

            arena = begun(trajectory, self.policy).arena
            self._film(replay(trajectory, self.policy), arena, len(trajectory.chosen))

    def _film(self, frames: Iterable[Frame], arena: Arena, decisions: int) -> None:
        from robosim.analysis.film import film
        from robosim.envs.render import LONG_SIDE
        from robosim.learning.interrupts import hold_interrupts

        assert self.video is not None  # noqa: S101  # who calls has made sure, which mypy cannot know
        speed = self.speed or 1.0
        filmed = 0

        def until_interrupted() -> Iterator[Frame]:
            nonlocal filmed
            for frame in frames:
                filmed = frame.step
                yield frame
                if interrupted():
                    return

        # What has been filmed is kept, however long the film was meant to be.
        with hold_interrupts() as interrupted, _show_progress(decisions, "filming") as on_step:
            told = _told(until_interrupted(), on_step)
            film(told, arena, self.video, speed=speed, long_side=self.size or LONG_SIDE)
        seconds, size = filmed * arena.timing.decision_period, self.video.stat().st_size / 1e6
        print(f"{self.video}: {filmed} decisions, {seconds:.0f} s at speed {speed:g}, {size:.1f} MB")
        if filmed < decisions:
            raise KeyboardInterrupt

    def _run_log(self) -> None:
        """Record what the log of a controller tells."""
        from robosim.cli.control_log import record_log
        from robosim.errors import InputError

        for option in fields(self):
            if option.name not in _OF_LOGS and getattr(self, option.name) != option.default:
                raise InputError(
                    f"--{option.name.replace('_', '-')} cannot be given with {self.policy}: "
                    "the log of a controller is shown as it is, whole or up to --steps."
                )
        what, complete = record_log(Path(self.policy), self.recording, self.steps)
        self._say_done(what, complete)
        if self.view:
            from robosim.cli.view import View

            View(self.recording).run()

    def _run_clogs(self, again: bool) -> bool:
        """Watch first, then record the clogs; return whether there were any."""
        from robosim.playback.file import require_recording

        require_recording(self.recording)
        trajectory, about, found = self._watch(again)
        if not found.clogs:
            decisions = len(trajectory.chosen)
            print(f"No clog in {decisions} decisions: nothing to record, {self.save} was not written.")
            return False
        self._record_clogs(trajectory, about, found)
        return True

    def _watch(self, again: bool) -> tuple[Trajectory, dict[str, str], FoundClogs]:
        """Return an episode as it went, what a recording says about it, and its clogs."""
        from robosim.playback.episode import watch_episode, watch_trajectory

        if again:
            trajectory = self._load()
            with _show_progress(len(trajectory.chosen), "watching") as on_step:
                found = watch_trajectory(trajectory, on_step=on_step, source=self.policy)
            return trajectory, self._about(trajectory.config.world, trajectory), found
        controller, env = self._team()
        with _show_progress(env.episode_steps, "watching") as on_step:
            found = watch_episode(controller, env, on_step=on_step)
        trajectory = env.trajectory(policy=self.policy)
        self._save_trajectory(trajectory)
        return trajectory, self._about(env.config.world), found

    def _record_clogs(self, trajectory: Trajectory, about: dict[str, str], found: FoundClogs) -> None:
        from robosim.playback.episode import decisions_run, record_trajectory, spans_around, widened

        decisions, clogs = len(trajectory.chosen), _number(found.clogs)
        around = AROUND if self.around is None else self.around
        spans = spans_around(found.clogs, around, found.arena)
        wanted = decisions_run(spans, decisions, found.arena)
        about = {**about, "recorded": f"{clogs}, and {around:g} s before and after each"}
        with _show_progress(wanted, "recording") as on_step:
            recorded = record_trajectory(
                trajectory, self.recording, about=about, spans=spans, on_step=on_step, source=self.policy
            )
        # The moment before the first decision is none.
        kept = sum(end - max(1, start) for start, end in widened(spans, decisions))
        complete = recorded.decisions == wanted
        what = f"{kept} of {decisions} decisions" if complete else f"up to decision {recorded.decisions}"
        self._say_done(f"{clogs}, {what}", complete)

    def _team(self) -> tuple[Controller, VectorEnv]:
        from robosim.control.controller import make_controller
        from robosim.control.environment import environment_for
        from robosim.episodes.trajectory import require_place

        if self.save_trajectory is not None:
            require_place(self.save_trajectory)
        controller = make_controller(self.policy)
        env = environment_for(
            controller,
            self.arena,
            self.robots,
            self.world,
            seed=self.seed or 0,
            episode_steps=self.steps,
            autoreset=False,
            profile=self.profile,
            odometry=self.odometry,
        )
        return controller, env

    def _load(self) -> Trajectory:
        """Return the trajectory to run again, as far as it is wanted."""
        from robosim.episodes.trajectory import load_trajectory
        from robosim.errors import InputError

        for option in ("arena", "robots", "world", "profile", "odometry", "seed", "save_trajectory"):
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
        return replace(trajectory, chosen=trajectory.chosen[:wanted])

    def _about(self, world: str, trajectory: Trajectory | None = None) -> dict[str, str]:
        # Rigid bodies are what runs where nothing else is said.
        elsewhere = {} if world == "physics" else {"world": world}
        if trajectory is None:
            return {"policy": self.policy, "seed": str(self.seed or 0), **elsewhere}
        return {
            "policy": trajectory.policy or "unknown",
            "trajectory": Path(self.policy).name,
            "environment_seed": str(trajectory.seed),
            "episode": str(trajectory.episode),
            **elsewhere,
        }

    def _save_trajectory(self, trajectory: Trajectory) -> None:
        if self.save_trajectory is not None:
            trajectory.save(self.save_trajectory)
            print(f"{self.save_trajectory}: run it again with: {hint('play', self.save_trajectory)}")


def _number(clogs: list[Clog]) -> str:
    return "1 clog" if len(clogs) == 1 else f"{len(clogs)} clogs"


def _paced(on_step: OnStep, seconds: float) -> OnStep:
    """Return what is told of a decision, and waits until the clock says that it has happened."""
    begun = time.monotonic()

    def wait(step: int, delivered: int) -> None:
        on_step(step, delivered)
        time.sleep(max(0.0, begun + step * seconds - time.monotonic()))

    return wait


def _told(frames: Iterable[Frame], on_step: OnStep) -> Iterator[Frame]:
    """Pass frames on, and tell of each."""
    for frame in frames:
        yield frame
        on_step(frame.step, int(frame.delivered.sum()))


@contextlib.contextmanager
def _show_progress(steps: int, doing: str = "") -> Iterator[OnStep]:
    """Yield what shows the decisions taken: a bar in a terminal, ten lines in a pipe.

    `doing` names the pass, where there are two.
    """
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
                print(f"{doing} step {step}/{steps}  {figures(step, delivered)}".lstrip(), flush=True)

        yield print_line
        return

    columns = (
        TextColumn(doing or "recording"),
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
