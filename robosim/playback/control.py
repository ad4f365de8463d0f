"""What a controller of real robots knew and commanded, from its log to a recording."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from robosim.arena.model import Arena
from robosim.episodes.columns import FrameColumns
from robosim.episodes.control_frame import ControlFrame
from robosim.episodes.frame import Frame
from robosim.playback import palette
from robosim.playback.blueprint import make_control_blueprint
from robosim.playback.controlwriter import ControlWriter
from robosim.playback.file import recording_file, require_space
from robosim.playback.recorder import send_about
from robosim.playback.scene import send_legend, send_stage
from robosim.world.contacts import no_contacts
from robosim.world.state import ABSENT, LOOSE


class ControlRecorder:
    """Takes the control periods of one log; `control_recording` makes one."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        arena: Arena,
        robots: int,
        action_names: Sequence[str],
        folder: Path,
        facts: Mapping[str, str],
    ) -> None:
        self._stream, self._arena, self._folder = stream, arena, folder
        self._facts = dict(facts)
        self._robots = robots
        self._columns = FrameColumns(robots, robots, (arena.rows, arena.columns))
        self._frames: list[ControlFrame] = []
        self._own_map = False
        self._writer = ControlWriter(stream, arena, robots, action_names)

    def add(self, frame: ControlFrame) -> None:
        """Record a control period; OSError if the disk has no room for it."""
        self._frames.append(_kept(frame))
        self._own_map |= frame.pheromone is not None
        if self._columns.add(self._as_frame(frame)):
            self.flush()

    def tell(self, facts: Mapping[str, str]) -> None:
        """Say more of what the recording is: what is known once all has been worked through."""
        self._facts |= facts

    def flush(self) -> None:
        """Hand what has been added to the file's writer; raises OSError if the disk has no room for it."""
        if not self._frames:
            return
        require_space(self._folder, self._columns.nbytes)
        self._writer.write(self._columns, self._frames, own_map=self._own_map)
        self._columns.clear()
        self._frames.clear()

    def finish(self) -> None:
        """Write what is left; `control_recording` does it at the end."""
        self.flush()
        self._writer.finish()
        send_about(self._stream, self._arena, self._facts, _HOW_TO_READ)

    def _as_frame(self, frame: ControlFrame) -> Frame:
        """Return what a scene shows of it; what a log does not know is empty, and not written."""
        known = np.asarray(np.isfinite(frame.pellet).all(axis=1))
        unknown = np.zeros(self._robots)
        field = frame.pheromone
        return Frame(
            step=frame.step,
            time=frame.time,
            pose=frame.pose,
            mode=frame.mode,
            laden=frame.laden,
            action=frame.action,
            reward=unknown.astype(np.float32),
            pellets=np.where(known[:, None], frame.pellet, 0.0),
            pellet_status=np.where(known, LOOSE, ABSENT).astype(np.uint8),
            delivered=unknown.astype(np.int64),
            energy=unknown,
            closest=unknown,
            density=0.0,
            pheromone=np.zeros((self._arena.rows, self._arena.columns)) if field is None else field,
            contacts=no_contacts(),
        )


@contextlib.contextmanager
def control_recording(
    path: str | Path,
    arena: Arena,
    *,
    robots: int,
    action_names: Sequence[str],
    about: Mapping[str, str],
) -> Iterator[ControlRecorder]:
    """Record what a controller of `robots` robots in `arena` knew and commanded to `path`, a .rrd file.

    The file appears under its name when the block ends without an exception; with one, nothing is left.
    Raises InputError on entry if the file cannot be written.
    """
    team = arena.team(robots)
    facts = {"arena": f"{arena.name}: {arena.description}", "robots": str(robots), **about}
    name = ", ".join((arena.name, f"{robots} robots", *about.values()))
    with recording_file(Path(path), make_control_blueprint(arena, robots), name) as stream:
        send_stage(stream, arena, team)
        send_legend(stream, palette.control_legend(team))
        recorder = ControlRecorder(stream, arena, robots, action_names, Path(path).parent, facts)
        yield recorder
        recorder.finish()


def _kept(frame: ControlFrame) -> ControlFrame:
    """Return a frame whose arrays nobody else writes to; the map is kept elsewhere."""
    arrays = ("pose", "age", "mode", "laden", "touched", "pellet", "action", "target", "wheel_speeds")
    copies: dict[str, Any] = {name: getattr(frame, name).copy() for name in (*arrays, "gripper", "unstopped")}
    return replace(frame, pheromone=None, **copies)


_HOW_TO_READ = """## How to read it

- All of it is from the log of a controller, or follows from it by the controller's own code: modes and
  pheromones from what was read and decided. Nothing else is shown: loose pellets that nobody knew of, who
  touched whom and how hard, what was delivered, and rewards are not in a log.
- A robot is drawn where it was last seen. Its fill is its mode, an orange outline says that its gripper holds
  a pellet. A magenta ring: its controller has stopped it; the lanes `stops` and the events say why.
- A square, and the line to it: the cell that a robot has chosen, from where it chose. Teal lines at its
  sides: what its wheels are commanded, ahead or back, as long as the robot at top speed.
- Brown discs: the loose pellet nearest to each gripper, where one is known.
- Violet cells: the pheromone map as the controller held it.
- The time line `sim_time` counts from the log's first line, a row for each control period; `step` counts
  decisions.
"""
