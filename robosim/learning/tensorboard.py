"""Curves of a run for TensorBoard: one for each figure of the metrics, over joint decisions."""

from __future__ import annotations

import math
import time
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from robosim.errors import InputError
from robosim.learning.metrics import Metrics

_NOT_CURVES = {"step", "decisions", "delivered", "stage"}


class Curves:
    """An event file that `tensorboard --logdir RUN` shows, written row by row as the run goes on.

    torch's SummaryWriter writes from a thread of its own, which dies with a traceback when the folder goes
    away; this one says so in a sentence, as an InputError, where the run can stop.
    """

    def __init__(self, folder: Path, step: int) -> None:
        """Go on from joint decision `step`: what an interrupted run has written beyond it is hidden."""
        now = time.time()
        self._path = folder / f"events.out.tfevents.{now:.6f}"
        try:
            folder.mkdir(exist_ok=True)
            self._file = self._path.open("wb")
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror or error}.") from error
        self._writer = RecordWriter(self._file)
        self._write(Event(wall_time=now, file_version="brain.Event:2"))
        if step:
            start = SessionLog(status=SessionLog.START)
            self._write(Event(wall_time=now, step=step + 1, session_log=start))

    def add(self, row: Metrics) -> None:
        """Add a row of the metrics; InputError when it cannot be written."""
        figures = {name: value for name, value in row.as_record().items() if name not in _NOT_CURVES}
        figures["pellets_per_1000"] = 1000.0 * row.delivered / row.decisions
        values = [Summary.Value(tag=n, simple_value=v) for n, v in figures.items() if not math.isnan(v)]
        self._write(Event(wall_time=time.time(), step=row.step, summary=Summary(value=values)))

    def close(self) -> None:
        self._file.close()

    def _write(self, event: Event) -> None:
        try:
            self._writer.write(event.SerializeToString())
            self._file.flush()
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written: {error.strerror or error}.") from error
