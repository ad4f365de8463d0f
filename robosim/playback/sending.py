"""Columns of rows to the stream, on both timelines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from robosim.playback import entities


def send_rows(
    stream: rr.RecordingStream,
    path: str,
    step: NDArray[np.integer],
    time: NDArray[np.float64],
    columns: Iterable[rr.ComponentColumn],
) -> None:
    """Send one row for each decision of `step` [rows] and its time [rows] in s."""
    # Rounded here, since rerun cuts what is below a nanosecond off.
    nanoseconds = np.rint(time * 1e9).astype("timedelta64[ns]")
    times = [
        rr.TimeColumn(entities.STEP, sequence=step),
        rr.TimeColumn(entities.TIME, duration=nanoseconds),
    ]
    rr.send_columns(path, times, columns, recording=stream)
