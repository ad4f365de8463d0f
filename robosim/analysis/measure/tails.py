"""The tail of a distribution: a power law fitted to the lapses between passages shows a clogging flow.

scipy.stats fits a Pareto law to a whole sample, but does not look for where a tail begins; that search, after
Clauset et al. (2009), is what this module is about.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
LEAST = 50
"""Fewer values than these are not fitted."""
LEAST_IN_TAIL = 10
"""A tail of fewer values is not considered."""


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """p(t) ~ t^-alpha for t >= t_min."""

    alpha: float
    """Exponent. At 2 and below, the mean lapse has no bound: the flow clogs (Zuriguel et al. 2014)."""
    error: float
    """Standard error of `alpha`, (alpha - 1) / sqrt(n)."""
    t_min: float
    """Where the tail begins, s."""
    values: int
    """How many values are in it."""
    distance: float
    """Kolmogorov-Smirnov distance between tail and fit."""


def survival(values: ArrayLike) -> tuple[Floats, Floats]:
    """Return the sorted values, and the share of all values that are at least as large as each."""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    smaller = ordered.searchsorted(ordered, side="left")
    return ordered, 1.0 - smaller / max(len(ordered), 1)


def fit_power_law(values: ArrayLike) -> PowerLaw | None:
    """Fit the tail of positive `values`; None for fewer than `LEAST`, or when they are all the same.

    alpha = 1 + n / sum(ln(t / t_min)), the maximum likelihood; t_min is where the tail fits best by the
    Kolmogorov-Smirnov distance. (Clauset, Shalizi, Newman 2009.)
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    ordered = ordered[ordered > 0.0]
    if len(ordered) < LEAST:
        return None
    best: PowerLaw | None = None
    for first in np.unique(ordered, return_index=True)[1].tolist():
        tail = ordered[first:]
        count = len(tail)
        if count < LEAST_IN_TAIL:
            break
        logs = np.log(tail / tail[0])
        total = float(logs.sum())
        if total <= 0.0:
            break
        alpha = 1.0 + count / total
        fitted = 1.0 - np.exp((1.0 - alpha) * logs)
        steps = np.arange(count) / count
        distance = float(np.maximum(np.abs(fitted - steps), np.abs(fitted - steps - 1.0 / count)).max())
        if best is None or distance < best.distance:
            best = PowerLaw(alpha, (alpha - 1.0) / float(np.sqrt(count)), float(tail[0]), count, distance)
    return best
