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
