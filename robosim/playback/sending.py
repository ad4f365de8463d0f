"""Columns of rows to the stream, on both timelines, and streams below a root of their own."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from robosim.playback import entities


class Rooted:
    """A stream whose entities all lie below a root: several scenes fit one recording so."""

    def __init__(self, stream: rr.RecordingStream, root: str) -> None:
        self._stream, self._root = stream, root

    def log(self, path: str, *archetypes: Any, static: bool = False) -> None:
        """Log as a stream does."""
        self._stream.log(f"{self._root}/{path}", *archetypes, static=static)

    def send_property(self, name: str, values: Any) -> None:
        """Send a property of the recording, under a name that begins with the root."""
        self._stream.send_property(f"{self._root}_{name}", values)

    def send_columns(
        self, path: str, indexes: Iterable[rr.TimeColumn], columns: Iterable[rr.ComponentColumn]
    ) -> None:
        """Send columns as a stream does."""
        self._stream.send_columns(f"{self._root}/{path}", indexes, columns)


Stream = rr.RecordingStream | Rooted
"""What a scene and its frames are written to."""


def send_rows(
    stream: Stream,
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
    stream.send_columns(path, times, columns)
