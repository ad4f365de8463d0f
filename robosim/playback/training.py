"""A training that is watched while it runs: its first environment, its clogs and its learning curve."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from robosim.arena.model import Arena
from robosim.episodes.frame import Frame
from robosim.errors import IncompleteError, InputError
from robosim.playback.recorder import Recorder, recording


class Watched(Protocol):
    """What a recording needs of the environments that a team learns in."""

    robots: int
    arena: Arena

    def frame(self, env: int = 0) -> Frame: ...


class Row(Protocol):
    """What a recording needs of a row of the metrics."""

    decisions: int
    delivered: int
    reward: float
    blocked: float
    figures: Mapping[str, float]


class LiveTraining:
    """Records the first environment of a training, and shows it in a viewer meanwhile.

    It only looks, so that the training has the same bits as without. Each stage of a curriculum is a
    recording of its own, in which decisions go on from episode to episode.
    """

    def __init__(
        self,
        folder: Path,
        about: Mapping[str, str],
        viewer: AbstractContextManager[str],
        say: Callable[[str], None],
    ) -> None:
        """Record to `folder`; `viewer` gives the URL at which one listens, such as `live_viewer`.

        Neither is there before the first decision: what keeps a training from beginning opens no viewer.
        `say` is told of each recording when it is whole, and why there is none any more.
        """
        self._folder = folder
        self._about = dict(about)
        self._viewer = viewer
        self._say = say
        self._url: str | None = None
        self._viewing = contextlib.ExitStack()
        self._recording = contextlib.ExitStack()
        self._env: Watched | None = None
        self._recorder: Recorder | None = None
        self._path = folder
        self._step = 0
        self._failed = False

    def __call__(self, env: Watched, step: int, row: Row | None) -> None:
        """Take in what a decision has led to; `step` counts joint decisions of the whole run.

        A recording that fails ends, also for want of its viewer, and the training goes on.
        """
        if self._failed:
            return
        try:
            self._take(env, step, row)
        except (OSError, InputError, IncompleteError) as error:
            self._failed = True
            reason = error.strerror if isinstance(error, OSError) else str(error).rstrip(".")
            self._say(f"{self._path}: the recording has ended ({reason}); the training goes on.")

    def close(self) -> None:
        """End the present recording, which is then whole, and what the viewer needs of this process."""
        with self._viewing:
            self._end_recording()

    def _end_recording(self) -> None:
        recorded = self._recorder is not None and not self._failed
        self._recorder = None
        try:
            self._recording.close()
        except OSError as error:
            self._say(f"{self._path}: the recording could not be written ({error.strerror}).")
        else:
            if recorded:
                self._say(str(self._path))

    def _take(self, env: Watched, step: int, row: Row | None) -> None:
        if env is not self._env:
            # What ends a stage leads to the start of the next; the row that it closes is of the stage before.
            if self._recorder is not None and row is not None:
                _plot(self._recorder, row)
                row = None
            self._end_recording()
            self._begin(env, step)
        assert self._recorder is not None  # noqa: S101  # begun just now, which mypy cannot know
        frame = env.frame()
        if frame.step == 0:
            # Another episode: nobody comes from where they were before.
            self._recorder.pause()
            self._step += 1
        self._step += 1
        self._recorder.add(_at(frame, self._step, env.arena.timing.decision_period))
        if row is not None:
            _plot(self._recorder, row)

    def _begin(self, env: Watched, step: int) -> None:
        if self._url is None:
            self._url = self._viewing.enter_context(self._viewer)
        self._env, self._step = env, 0
        self._folder.mkdir(exist_ok=True)
        self._path = self._folder / f"live-{step:012d}.rrd"
        self._recorder = self._recording.enter_context(
            recording(
                self._path,
                env.arena,
                robots=env.robots,
                about={**self._about, "from": f"joint decision {step}"},
                viewer=self._url,
                learning=True,
            )
        )


def _plot(recorder: Recorder, row: Row) -> None:
    per_thousand = 1000.0 * row.delivered / row.decisions
    own = {f"figures/{name}": value for name, value in row.figures.items()}
    recorder.plot({"pellets": per_thousand, "reward": row.reward, "blocked": row.blocked, **own})


def _at(frame: Frame, step: int, period: float) -> Frame:
    """Return a frame of some episode as that of a decision of the whole stage."""
    later = step * period - frame.time
    contacts = replace(frame.contacts, time=frame.contacts.time + later)
    return replace(frame, step=step, time=step * period, contacts=contacts)
