"""How a team shares its work: Lorenz curve and Gini coefficient."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def lorenz_curve(work: ArrayLike) -> Floats | None:
    """Return the Lorenz curve of `work` [robots]: [robots + 1, 2] share of the robots, share of the work.

    Robots are in the order of their work, the least first, so the curve is convex and runs from (0, 0)
    to (1, 1); the diagonal is equal work. None when there is no work to share. (Lorenz 1905; for diggers
    Aguilar et al. 2018.)
    """
    sorted_work = np.sort(np.asarray(work, dtype=np.float64))
    total = sorted_work.sum()
    if total <= 0.0:
        return None
    curve = np.zeros((len(sorted_work) + 1, 2))
    curve[1:, 0] = np.arange(1, len(sorted_work) + 1) / len(sorted_work)
    curve[1:, 1] = np.cumsum(sorted_work) / total
    return curve


def gini(work: ArrayLike) -> float | None:
    """Return the Gini coefficient of `work` [robots], or None when there is none to share.

    G = 1 - 2 A with A the area under the Lorenz curve: 0 when all do the same, (n - 1) / n when one of n
    does everything. (Gini 1912.)
    """
    curve = lorenz_curve(work)
    if curve is None:
        return None
    width = np.diff(curve[:, 0])
    area = float((width * 0.5 * (curve[1:, 1] + curve[:-1, 1])).sum())
    return max(0.0, 1.0 - 2.0 * area)
