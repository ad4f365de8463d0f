"""Statistics of few runs: interquartile means, bootstrap intervals, probability of improvement, profiles.

After Agarwal 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice". A score is one
number of one run, the runs of a task differ in their seeds, and resampled are runs, within their task.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robosim.equality import EqualByValue
from robosim.errors import InputError

Floats = NDArray[np.float64]

LEAST_RUNS = 3
"""With fewer runs of a task an interval would say nothing."""
RESAMPLES = 10_000
LEVEL = 0.95

Scores = ArrayLike | Sequence[ArrayLike]
"""Scores [runs] of one task, [runs, tasks] of several, or a sequence of one [runs] for each task: tasks may
have unequal numbers of runs."""

Statistic = Callable[[Sequence[Floats], Sequence[Floats]], Floats]
"""Takes the scores [runs] of each task, and for each task how often each run was drawn [resamples, runs];
returns its value for every resample [resamples]."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A statistic of the runs, and the interval in which it would lie for other seeds."""

    value: float
    low: float | None
    """Bounds of the 95 % interval; None where a task has fewer than `LEAST_RUNS` runs."""
    high: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Band(EqualByValue):
    """A statistic at every point of a curve, with an interval for each: all arrays are [points]."""

    value: Floats
    low: Floats | None
    """Bounds of the 95 % intervals; None where a task has fewer than `LEAST_RUNS` runs."""
    high: Floats | None


def interquartile_mean(tasks: Sequence[Floats], draws: Sequence[Floats]) -> Floats:
    """Return the mean of the middle half of all scores of all tasks: a `Statistic` (Agarwal 2021, 4.3).

    Of n scores the floor(n / 4) lowest and highest count for nothing, so with three it is the mean.
    """
    scores, counts = np.concatenate(tasks), np.concatenate(draws, axis=1)
    order = np.argsort(scores, kind="stable")
    scores, counts = scores[order], counts[:, order]
    size = len(scores)
    cut = size // 4
    ends = np.cumsum(counts, axis=1)
    kept = np.clip(np.minimum(ends, size - cut) - np.maximum(ends - counts, cut), 0.0, None)
    return np.asarray(kept @ scores / (size - 2 * cut))


def mean(tasks: Sequence[Floats], draws: Sequence[Floats]) -> Floats:
    """Return the mean over tasks of the mean over runs: a `Statistic`."""
    return np.asarray(_task_means(tasks, draws).mean(axis=1))


def median(tasks: Sequence[Floats], draws: Sequence[Floats]) -> Floats:
    """Return the median over tasks of the mean over runs: a `Statistic`. Of one task it is the mean."""
    return np.asarray(np.median(_task_means(tasks, draws), axis=1))


def optimality_gap(tasks: Sequence[Floats], draws: Sequence[Floats]) -> Floats:
    """Return how far scores stay below 1, where those above count as 1: a `Statistic` (Agarwal 2021).

    Meant for normalised scores; the mean over tasks of the mean over runs.
    """
    return 1.0 - mean([np.minimum(scores, 1.0) for scores in tasks], draws)


def point(statistic: Statistic, scores: Scores) -> float:
    """Return a statistic of the scores themselves; errors as `estimate`."""
    tasks = _as_tasks(scores)
    return float(statistic(tasks, _each_once(tasks))[0])


def estimate(
    statistic: Statistic, scores: Scores, seed: int = 0, resamples: int = RESAMPLES, level: float = LEVEL
) -> Estimate:
    """Return a statistic of the scores with its stratified bootstrap interval, by percentiles.

    Runs are drawn with replacement within each task, as many as it has (Agarwal 2021, section 4.1). Equal
    arguments give equal results. InputError for a task without scores, and for a score that is not finite.
    """
    tasks, value = _as_tasks(scores), point(statistic, scores)
    if _too_few(tasks):
        return Estimate(value, None, None)
    drawn = statistic(tasks, _draw(tasks, resamples, np.random.default_rng(seed)))
    low, high = _bounds(drawn, level)
    return Estimate(value, float(low), float(high))


def band(
    statistic: Statistic, values: ArrayLike, seed: int = 0, resamples: int = 2000, level: float = LEVEL
) -> Band:
    """Return a statistic of the runs of one task at every point of curves, `values` [runs, points].

    All points are resampled alike, and each has its own interval. Errors as `estimate`.
    """
    columns = [_as_tasks(column)[0] for column in np.asarray(values, dtype=np.float64).T]
    value = np.array([statistic([column], _each_once([column]))[0] for column in columns])
    if _too_few(columns):
        return Band(value, None, None)
    draws = _draw(columns[:1], resamples, np.random.default_rng(seed))
    bounds = np.array([_bounds(statistic([column], draws), level) for column in columns])
    return Band(value, bounds[:, 0], bounds[:, 1])


def probability_of_improvement(
    x: Scores, y: Scores, seed: int = 0, resamples: int = RESAMPLES, level: float = LEVEL
) -> Estimate:
    """Return how probable it is that a run of `x` scores higher than one of `y`, the mean over tasks.

    Equal scores count half: it is the Mann-Whitney U over the number of pairs (Agarwal 2021, section 4.3).
    Both are resampled on their own. InputError as `estimate`, and where they have unequal numbers of tasks.
    """
    ours, theirs = _as_tasks(x), _as_tasks(y)
    if len(ours) != len(theirs):
        raise InputError(f"scores of {len(ours)} and of {len(theirs)} tasks: only equal tasks compare.")
    wins = [0.5 * (1.0 + np.sign(a[:, None] - b[None, :])) for a, b in zip(ours, theirs, strict=True)]
    value = float(_share_won(wins, _each_once(ours), _each_once(theirs))[0])
    if _too_few(ours) or _too_few(theirs):
        return Estimate(value, None, None)
    rng = np.random.default_rng(seed)
    drawn = _share_won(wins, _draw(ours, resamples, rng), _draw(theirs, resamples, rng))
    low, high = _bounds(drawn, level)
    return Estimate(value, float(low), float(high))


def performance_profile(
    scores: Scores, thresholds: ArrayLike, seed: int = 0, resamples: int = RESAMPLES, level: float = LEVEL
) -> Band:
    """Return which share of runs scores above each of `thresholds` [thresholds], the mean over tasks.

    The run-score distribution of Agarwal 2021, section 4.2, with pointwise bands. Errors as `estimate`.
    """
    tasks, taus = _as_tasks(scores), np.asarray(thresholds, dtype=np.float64)
    above = [(task[:, None] > taus[None, :]).astype(np.float64) for task in tasks]
    share = _share_above(above, _each_once(tasks))[0]
    if _too_few(tasks):
        return Band(share, None, None)
    drawn = _share_above(above, _draw(tasks, resamples, np.random.default_rng(seed)))
    low, high = _bounds(drawn, level)
    return Band(share, low, high)


def _as_tasks(scores: Scores) -> list[Floats]:
    """Return the scores [runs] of each task."""
    if isinstance(scores, np.ndarray):
        if scores.ndim not in (1, 2):
            raise InputError(f"scores have {scores.ndim} axes, but must have [runs] or [runs, tasks].")
        tasks = list(np.atleast_2d(scores) if scores.ndim == 1 else scores.T)
    else:
        parts = [np.asarray(part, dtype=np.float64) for part in scores]  # type: ignore[union-attr]
        tasks = [np.array(parts)] if all(part.ndim == 0 for part in parts) else parts
    tasks = [np.asarray(task, dtype=np.float64) for task in tasks]
    if not tasks or any(task.ndim != 1 or len(task) == 0 for task in tasks):
        raise InputError("a task has no scores, but every task must have one at least.")
    if not all(np.isfinite(task).all() for task in tasks):
        raise InputError("a score is not finite, but all must be.")
    return tasks


def _too_few(tasks: Sequence[Floats]) -> bool:
    return min(map(len, tasks)) < LEAST_RUNS


def _each_once(tasks: Sequence[Floats]) -> list[Floats]:
    """Return the draws of the one resample that is the runs themselves."""
    return [np.ones((1, len(task))) for task in tasks]


def _draw(tasks: Sequence[Floats], resamples: int, rng: np.random.Generator) -> list[Floats]:
    """Return for each task how often each of its runs is drawn, [resamples, runs]."""
    sizes = [len(task) for task in tasks]
    return [rng.multinomial(size, np.full(size, 1.0 / size), resamples).astype(np.float64) for size in sizes]


def _bounds(drawn: Floats, level: float) -> Floats:
    """Return the two percentiles between which `level` of the resamples, the first axis, lie."""
    return np.asarray(np.quantile(drawn, [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0))


def _task_means(tasks: Sequence[Floats], draws: Sequence[Floats]) -> Floats:
    """Return the mean over runs, [resamples, tasks]."""
    means = [drawn @ scores / len(scores) for scores, drawn in zip(tasks, draws, strict=True)]
    return np.stack(means, axis=1)


def _share_won(wins: Sequence[Floats], ours: Sequence[Floats], theirs: Sequence[Floats]) -> Floats:
    """Return the mean over tasks of the share of pairs won, [resamples]; `wins` are [runs, their runs]."""
    shares = [((a @ won) * b).sum(axis=1) / won.size for won, a, b in zip(wins, ours, theirs, strict=True)]
    return np.asarray(np.mean(shares, axis=0))


def _share_above(above: Sequence[Floats], draws: Sequence[Floats]) -> Floats:
    """Return the mean over tasks of the share of runs, [resamples, thresholds]."""
    return np.asarray(
        np.mean([drawn @ one / len(one) for one, drawn in zip(above, draws, strict=True)], axis=0)
    )
