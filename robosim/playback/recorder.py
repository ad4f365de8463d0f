"""The recorder: takes a frame a decision, leaves a recording that opens in the rerun viewer."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import rerun as rr

from robosim.arena.model import Arena
from robosim.envs.profile import ProfileConfig
from robosim.episodes.columns import FrameColumns
from robosim.episodes.frame import Frame
from robosim.playback import entities
from robosim.playback.blueprint import make_blueprint
from robosim.playback.clogs import ClogWatch, Settled
from robosim.playback.clogwriter import ClogWriter
from robosim.playback.file import recording_file, require_space
from robosim.playback.scene import send_scene
from robosim.playback.sending import Stream, send_rows
from robosim.playback.writer import FrameWriter
from robosim.world.motion import MotionDraws

EVERY = 0.5
"""Time by the clock between two pictures that a viewer is shown of a run under way, s."""
EVERY_LEARNING = 3.0
"""The same of a training, which takes long: each picture makes its recording about 20 kB larger."""


class Recorder:
    """Takes the frames of one episode; `recording` makes one."""

    def __init__(
        self,
        stream: Stream,
        arena: Arena,
        robots: int,
        folder: Path,
        facts: Mapping[str, str],
        show_every: float = math.inf,
    ) -> None:
        self._show_every = show_every
        self._shown_at = time.monotonic()
        self._folder = folder
        self._stream = stream
        self._arena = arena
        self._facts = dict(facts)
        self._told = False
        self._writer = FrameWriter(stream, arena, robots)
        self._frames = FrameColumns(robots, arena.pellets.count, (arena.rows, arena.columns))
        self._clog_writer = ClogWriter(stream, arena, robots)
        self._clogs = ClogWatch(arena, robots, self._write_clogs)
        self._period = arena.timing.decision_period
        self._last_step = -1
        self._pauses: list[int] = []
        self._paused = True

    def add(self, frame: Frame) -> None:
        """Record a frame. Raises ValueError unless its step comes after the last one's."""
        self._follow(frame)
        self._paused = False
        self._clogs.add(frame, recorded=True)
        if self._frames.add(frame):
            self.flush()
        if time.monotonic() - self._shown_at >= self._show_every:
            self.show()

    def show(self) -> None:
        """Let whoever watches see all that has been added, and the clogs of it that are certain."""
        self.flush()
        self._clogs.settle()
        self._clog_writer.finish()
        self._shown_at = time.monotonic()

    def plot(self, values: Mapping[str, float]) -> None:
        """Draw a point of each curve of `values`, by name, at the latest frame."""
        for name, value in values.items():
            step, time = np.array([self._last_step]), np.array([self._last_step * self._period])
            send_rows(self._stream, entities.learning(name), step, time, rr.Scalars.columns(scalars=[value]))

    def tell_drawn(self, profile: ProfileConfig, drawn: MotionDraws) -> None:
        """Say, before the first frame, under which profile the episode runs, and what it has drawn."""
        self._facts |= {"profile": profile.called, **_in_words(drawn)}
        exact = {"profile": profile.model_dump_json(), "drawn": json.dumps(drawn.table())}
        self._stream.send_property("profile", rr.AnyValues(drop_untyped_nones=True, **exact))

    def skip(self, frame: Frame) -> None:
        """Pause, and take in a frame that is not recorded: it shows which clogs reach over the pause.

        Where the frames of a pause are left out, a clog ends with it, and its time counts anew after it.
        """
        self._follow(frame)
        self.pause()
        self._clogs.add(frame, recorded=False)

    def _tell(self) -> None:
        if not self._told:
            send_about(self._stream, self._arena, self._facts)
            self._told = True

    def _follow(self, frame: Frame) -> None:
        self._tell()
        if frame.step <= self._last_step:
            raise ValueError(
                f"step {frame.step} does not follow step {self._last_step}: a recording holds one episode"
            )
        self._last_step = frame.step

    def flush(self) -> None:
        """Hand what has been added to the file's writer; raises OSError if the disk has no room for it."""
        # In memory it is larger than in the file.
        require_space(self._folder, self._frames.nbytes)
        self._writer.write(self._frames, self._pauses)
        self._frames.clear()
        self._pauses.clear()

    def _write_clogs(self, settled: Settled) -> None:
        require_space(self._folder, settled.drawn.link.nbytes)
        self._clog_writer.write(settled)

    def finish(self) -> None:
        """Write what is left; `recording` does it at the end."""
        self._tell()
        self.flush()
        self._clogs.finish()
        self._clog_writer.finish()

    def pause(self) -> None:
        """Say that the next frame, if there is one, does not follow at once.

        Until then the picture stands still, the lanes are empty, and no event is written.
        """
        if not self._paused:
            self._pauses.append(self._frames.rows)
            self._paused = True


@contextlib.contextmanager
def recording(
    path: str | Path,
    arena: Arena,
    *,
    robots: int,
    about: Mapping[str, str] | None = None,
    viewer: str = "",
    learning: bool = False,
    rewards: bool = True,
) -> Iterator[Recorder]:
    """Record the frames of one episode of `robots` robots in `arena` to `path`, a .rrd file.

        with recording("run.rrd", env.arena, robots=env.robots, about={"policy": "lanes"}) as recorder:
            env.reset()
            recorder.add(env.frame())
            ...

    The file appears under its name when the block ends without an exception; with one, nothing is
    left. Raises InputError on entry if the file cannot be written. `about` says what the run is, in words.
    A viewer that listens at the URL `viewer` is shown frames as they come. With `learning` there is room for
    the curves of `Recorder.plot`; without `rewards`, which frames then have as NaN, there is none for them.
    """
    facts = {
        "arena": f"{arena.name}: {arena.description}",
        "robots": str(robots),
        **(about or {}),
    }
    name = ", ".join((arena.name, f"{robots} robots", *(about or {}).values()))
    blueprint = make_blueprint(arena, robots, follow=bool(viewer), learning=learning, rewards=rewards)
    with recording_file(Path(path), blueprint, name, viewer) as stream:
        send_scene(stream, arena, robots, rewards=rewards)
        every = (EVERY_LEARNING if learning else EVERY) if viewer else math.inf
        recorder = Recorder(stream, arena, robots, Path(path).parent, facts, every)
        yield recorder
        recorder.finish()


def send_about(stream: Stream, arena: Arena, facts: Mapping[str, str], how_to_read: str = "") -> None:
    """Send what a run is, in words, and how to read its recording."""
    lines = [f"- **{key}**: {value}" for key, value in facts.items()]
    text = "\n".join(["# About this run", "", *lines, "", how_to_read or _HOW_TO_READ])
    stream.log(entities.ABOUT, rr.TextDocument(text, media_type="text/markdown"), static=True)
    stream.send_property("robosim", rr.AnyValues(drop_untyped_nones=True, arena_file=arena.text, **facts))


def _in_words(drawn: MotionDraws) -> dict[str, str]:
    """Return what an episode has drawn, a line for each robot and one for the pellets."""
    words = {
        f"robot {robot}": (
            f"wheels x {left:.3f} and {right:.3f}, lag {lag:.3f} s, traction x {traction:.2f}, "
            f"mass x {mass:.2f}, commands {latency:.3f} s late"
        )
        for robot, ((left, right), lag, traction, mass, latency) in enumerate(
            zip(
                drawn.wheel_gain,
                drawn.motor_lag,
                drawn.traction,
                drawn.robot_mass,
                drawn.latency,
                strict=True,
            )
        )
    }
    pellets = f"mass x {drawn.pellet_mass:.2f}, friction x {drawn.pellet_friction:.2f}"
    return {**words, "pellets": pellets}


_HOW_TO_READ = """## How to read it

- A robot is drawn to scale, white line forward (in a mixed team of its group's colour), two fingers where it
  grips. The fill is its mode, as in the legend and in the lanes below the arena. An orange outline says that
  it carries a pellet.
- Violet cells: pheromone, the darker the more often visited of late.
- Small dots: where each robot was in the last 20 s, one a decision, in its colour in the plots.
- Discs where bodies touch: the larger, the greater the impulse.
- A magenta ring: the robot is in a clog. So are robots that want to move and cannot, touch each other or the
  same loose pellet, and let nobody through the tunnel for more than twice the time that a robot at top
  speed takes for it. Dark lines join those that touch.
- The lane `clogs` below the arena: an interval for each clog, with its cause and its robots. Orange: two met
  head-on; brown: blocked by a pellet; teal: one turning across the tunnel; light grey: a queue. The lanes
  `clogs_2` and so on hold clogs at the same time.
- Drag in a plot, in the lanes, or in the time line below to move through the run; click an event to jump
  to it.
"""
