"""Which rows of a column say something new; only those are written, and the viewer holds the last one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def changed_rows(values: NDArray[Any], before: NDArray[Any] | None) -> NDArray[np.bool_]:
    """Return for each row [rows, ...] whether it differs from the row before it.

    The first is compared with `before`, the last row of the previous chunk; without one it is new.
    """
    flat = values.reshape(len(values), -1)
    changed = np.empty(len(flat), dtype=np.bool_)
    np.any(flat[1:] != flat[:-1], axis=1, out=changed[1:])
    changed[0] = before is None or bool(np.any(values[0] != before))
    return changed


def onsets(
    pair: NDArray[np.int64], time: NDArray[np.float64], last: dict[int, float], pause: float
) -> NDArray[np.bool_]:
    """Return for each event whether it opens a series: no other of its pair in the `pause` s before it.

    Events are in order of time. `last` holds the time of each pair's last event in earlier chunks, and is
    brought up to date.
    """
    if len(pair) == 0:
        return np.zeros(0, dtype=np.bool_)
    order = np.lexsort((time, pair))
    sorted_pair, sorted_time = pair[order], time[order]
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = sorted_pair[1:] != sorted_pair[:-1]
    opens = np.ones(len(order), dtype=np.bool_)
    opens[1:] = first[1:] | (np.diff(sorted_time) > pause)
    ends = np.append(np.flatnonzero(first)[1:], len(order)) - 1
    for start, end in zip(np.flatnonzero(first).tolist(), ends.tolist(), strict=True):
        key = int(sorted_pair[start])
        opens[start] = bool(sorted_time[start] - last.get(key, -np.inf) > pause)
        last[key] = float(sorted_time[end])
    result = np.empty(len(order), dtype=np.bool_)
    result[order] = opens
    return result
