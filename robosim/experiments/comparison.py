"""Systems compared: for each task and over all of them, with intervals where there are runs enough."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from robosim.errors import InputError, nearest_names, shown
from robosim.experiments.runs import PELLETS, TOUCHES, Run, Task
from robosim.experiments.statistics import (
    LEAST_RUNS,
    Estimate,
    estimate,
    interquartile_mean,
    mean,
    median,
    optimality_gap,
    point,
    probability_of_improvement,
)

REFERENCE = "lanes"
"""The scripted controller that systems are measured by where nothing else is asked for."""
FEWER_IS_BETTER = frozenset({TOUCHES, "wheel_energy", "gini", "clogs", "clogged_share"})
"""Figures of which a smaller one is an improvement."""

Scores = Mapping[tuple[Task, str], Sequence[float]]
"""By task and system, a score for each run, in the order of their seeds."""


@dataclass(frozen=True, slots=True)
class Row:
    """A system in a task."""

    system: str
    seeds: Sequence[int]
    episodes: int
    """Of all runs together."""
    scores: Sequence[float]
    """Of each run, the mean over its episodes."""
    iqm: Estimate
    """Interquartile mean of the scores."""
    normalised: Estimate | None
    """The same as a share of the baseline's interquartile mean, which is taken as it is; None without one."""
    improvement: Estimate | None
    """Probability that a run does better than one of the baseline; None for the baseline and without one."""


@dataclass(frozen=True, slots=True)
class Table:
    """The systems in one task."""

    task: Task
    baseline: str | None
    """System that the others are measured by; None where it has no runs here."""
    scale: float
    """Its interquartile mean, that normalised scores are shares of; 0 where nothing is normalised."""
    rows: Sequence[Row]


@dataclass(frozen=True, slots=True)
class Overall:
    """A system over all tasks with a baseline, by its normalised scores."""

    system: str
    iqm: Estimate
    median: Estimate
    mean: Estimate
    optimality_gap: Estimate | None
    """How far runs stay below the baseline; those above it count as equal. None where fewer is better."""
    improvement: Estimate | None
    """Probability of improvement over the baseline, the mean over the tasks in which it is another system;
    None where it is the baseline in all of them."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a set of runs says about its systems."""

    metric: str
    tables: Sequence[Table]
    overall: Sequence[Overall]
    """Empty with a single task."""
    normalised: Mapping[str, Sequence[Sequence[float]]]
    """By system, normalised scores [tasks][runs] of those in `overall`, or of the only task."""
    notes: Sequence[str]
    """Sentences on what was left out, and why."""

    def as_record(self) -> dict[str, Any]:
        """Return everything as tables and lists, for a JSON file."""
        return asdict(self)


def compare(runs: Sequence[Run], metric: str = PELLETS, baseline: str | None = None) -> Comparison:
    """Compare the systems of `runs` by the means of a figure over each run's episodes.

    The baseline is a system or a technique by name; `lanes` by default, or where it has no runs, in each task
    the system with the best interquartile mean. InputError for a figure or a baseline that no run has.
    """
    scores, notes = _scores(runs, metric)
    tasks = list(dict.fromkeys(task for task, _ in scores))
    chosen = {task: _baseline(task, runs, scores, metric, baseline) for task in tasks}
    if baseline is not None and not any(chosen.values()):
        names = {run.system for run in runs}
        raise InputError(f"--baseline: no run is of {shown(baseline)}: {nearest_names(baseline, names)}")
    scales = {task: _scale(scores, task, chosen[task]) for task in tasks}
    notes += [
        f"{task}: {why}." for task in tasks if (why := _no_baseline(chosen[task], scales[task], baseline))
    ]
    tables = [_table(task, runs, scores, metric, chosen[task], scales[task]) for task in tasks]
    usable = [table for table in tables if table.scale > 0.0]
    systems = list(dict.fromkeys(row.system for table in usable for row in table.rows))
    whole = [name for name in systems if all((table.task, name) in scores for table in usable)]
    if len(usable) > 1 and (partial := [name for name in systems if name not in whole]):
        notes.append(
            f"Not in the figures over all tasks, since they lack runs of some: {', '.join(partial)}."
        )
    normalised = {
        name: [[value / scales[t.task] for value in scores[t.task, name]] for t in usable] for name in whole
    }
    overall = [_overall(name, normalised, usable, scores, metric) for name in whole]
    overall.sort(key=lambda one: one.iqm.value, reverse=metric not in FEWER_IS_BETTER)
    if any(row.iqm.low is None for table in tables for row in table.rows):
        notes.append(
            f"Fewer than {LEAST_RUNS} seeds say too little for an interval: their scores are printed."
        )
    return Comparison(metric, tables, overall if len(usable) > 1 else [], normalised, notes)


def _scores(runs: Sequence[Run], metric: str) -> tuple[dict[tuple[Task, str], list[float]], list[str]]:
    scores: dict[tuple[Task, str], list[float]] = defaultdict(list)
    without: dict[str, int] = defaultdict(int)
    for run in runs:
        score = run.score(metric)
        if score is None:
            without[run.system] += 1
        else:
            scores[run.task, run.system].append(score)
    if not scores:
        known = {name for run in runs for name, values in run.figures.items() if values}
        if not known:
            raise InputError("no run has any figure of an episode: there is nothing to compare.")
        raise InputError(f"--metric: no run has a figure {shown(metric)}: {nearest_names(metric, known)}")
    left = [f"{count} of {system}" for system, count in without.items()]
    return scores, [f"Left out are runs without a figure {metric}: {', '.join(left)}."] if left else []


def _baseline(task: Task, runs: Sequence[Run], scores: Scores, metric: str, asked: str | None) -> str | None:
    """Return the system that others are measured by in a task; None where there are no runs of it."""
    here = {run.system: run.technique for run in runs if run.task == task and (task, run.system) in scores}
    wanted = asked or REFERENCE
    named = [wanted] if wanted in here else [name for name in here if here[name] == wanted]
    if len(named) > 1 and asked:
        raise InputError(
            f"--baseline is {shown(asked)}, but there are {' and '.join(named)}: name one of them."
        )
    if len(named) == 1:
        return named[0]
    if asked or any(run.technique == REFERENCE for run in runs):
        return None
    best = min if metric in FEWER_IS_BETTER else max
    return best(here, key=lambda name: point(interquartile_mean, np.array(scores[task, name])))


def _scale(scores: Scores, task: Task, baseline: str | None) -> float:
    """Return the baseline's interquartile mean, 0 where there is none to divide by."""
    if baseline is None:
        return 0.0
    return max(0.0, point(interquartile_mean, np.array(scores[task, baseline])))


def _no_baseline(baseline: str | None, scale: float, asked: str | None) -> str:
    """Return why nothing is normalised in a task; empty where it is."""
    if baseline is None:
        return f"no runs of {asked or REFERENCE} here, so nothing is normalised"
    return "" if scale > 0.0 else f"{baseline} has no score above 0, so nothing is normalised"


def _table(
    task: Task, runs: Sequence[Run], scores: Scores, metric: str, baseline: str | None, scale: float
) -> Table:
    rows = []
    for system in dict.fromkeys(run.system for run in runs if (run.task, run.system) in scores):
        if (task, system) not in scores:
            continue
        own = [r for r in runs if r.task == task and r.system == system and r.score(metric) is not None]
        values = scores[task, system]
        iqm = estimate(interquartile_mean, np.array(values))
        better = None
        if baseline is not None and system != baseline:
            better = _improvement([values], [scores[task, baseline]], metric)
        rows.append(
            Row(
                system=system,
                seeds=[run.seed for run in own],
                episodes=sum(len(run.figures[metric]) for run in own),
                scores=values,
                iqm=iqm,
                normalised=_divided(iqm, scale) if scale > 0.0 else None,
                improvement=better,
            )
        )
    rows.sort(key=lambda row: row.iqm.value, reverse=metric not in FEWER_IS_BETTER)
    return Table(task, baseline, scale, rows)


def _overall(
    system: str,
    normalised: Mapping[str, Sequence[Sequence[float]]],
    tables: Sequence[Table],
    scores: Scores,
    metric: str,
) -> Overall:
    values = [np.array(task) for task in normalised[system]]
    better = None
    # A system that is the baseline of a task has nobody to be better than there.
    if others := [table for table in tables if table.baseline != system]:
        ours = [scores[table.task, system] for table in others]
        theirs = [scores[table.task, str(table.baseline)] for table in others]
        better = _improvement(ours, theirs, metric)
    gap = None if metric in FEWER_IS_BETTER else estimate(optimality_gap, values)
    return Overall(
        system,
        iqm=estimate(interquartile_mean, values),
        median=estimate(median, values),
        mean=estimate(mean, values),
        optimality_gap=gap,
        improvement=better,
    )


def _improvement(ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]], metric: str) -> Estimate:
    sign = -1.0 if metric in FEWER_IS_BETTER else 1.0
    return probability_of_improvement(
        [sign * np.array(one) for one in ours], [sign * np.array(one) for one in theirs]
    )


def _divided(one: Estimate, scale: float) -> Estimate:
    if one.low is None or one.high is None:
        return Estimate(one.value / scale, None, None)
    return Estimate(one.value / scale, one.low / scale, one.high / scale)
