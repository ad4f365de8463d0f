"""What the figures of a comparison show, from its runs and its numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence

import numpy as np

from robosim.analysis.figures import comparison as draw
from robosim.analysis.figures.comparison import Line, Panel, Systems
from robosim.analysis.figures.rendering import Rendered, render
from robosim.analysis.figures.style import look
from robosim.analysis.measure.workload import lorenz_curve
from robosim.experiments.comparison import FEWER_IS_BETTER, Comparison, Row
from robosim.experiments.runs import PELLETS, TOUCHES, Floats, Run, Task
from robosim.experiments.statistics import Estimate, band, interquartile_mean, performance_profile

CURVE_POINTS = 40
_THRESHOLDS = 201


def draw_comparison(
    comparison: Comparison,
    runs: Sequence[Run],
    names: Sequence[str] = (),
    figures: Collection[str] | None = None,
) -> Iterator[tuple[str, Rendered]]:
    """Yield each figure that there is something to draw for, by its name; equal runs give equal bytes.

    `figures` names those that are wanted; None wants all. Systems get their colours in the order of `names`,
    which may hold more than there are, then in that of the runs: figures drawn with the same names show a
    system alike.
    """
    tasks = [table.task for table in comparison.tables]
    teams = [task for task in tasks if task.robots > 1]
    baselines = {table.baseline for table in comparison.tables if table.baseline is not None}
    reference = baselines.pop() if len(baselines) == 1 else None
    systems = Systems(list(dict.fromkeys([*names, *(run.system for run in runs)])), reference)
    baseline = reference or "the best system"

    def wanted(name: str) -> bool:
        return figures is None or name in figures

    def panels(of: Sequence[Task], lines: Callable[[dict[str, list[Run]]], list[Line]]) -> list[Panel]:
        found = [_panel(task, tasks, lines(_runs_of(runs, task))) for task in of]
        return [panel for panel in found if panel.lines]

    with look():
        if wanted("learning-curves") and (filled := panels(tasks, _learned)):
            yield "learning-curves", render(draw.learning_curves(filled, systems))
        if wanted("team-size"):
            yield "team-size", render(draw.by_team_size(_sizes(comparison), systems, comparison.metric))
        if wanted("profiles") and comparison.normalised and comparison.metric not in FEWER_IS_BETTER:
            lines = _profiles(comparison)
            yield "profiles", render(draw.performance_profiles(lines, systems, baseline))
        if wanted("improvement"):
            better = [_panel(table.task, tasks, _improvements(table.rows)) for table in comparison.tables]
            if filled := [panel for panel in better if panel.lines]:
                yield "improvement", render(draw.improvement(filled, systems, baseline))
        if wanted("pellets") and (filled := panels(tasks, _delivered_by_then)):
            yield "pellets", render(draw.cumulative_pellets(filled, systems))
        if wanted("lorenz") and (filled := panels(teams, _shares)):
            yield "lorenz", render(draw.lorenz_curves(filled, systems))
        if wanted("touches") and (filled := panels(teams, _touches)):
            yield "touches", render(draw.pellets_against_touches(filled, systems))


def _panel(task: Task, tasks: Sequence[Task], lines: Sequence[Line]) -> Panel:
    """Return a panel, titled by what tells its task from the others."""
    places = set(map(_place, tasks))
    robots = f"{task.robots} robot" + ("s" if task.robots > 1 else "")
    return Panel(robots if len(places) == 1 else f"{_place(task)},\n{robots}", lines)


def _place(task: Task) -> str:
    under = f", under {task.profile}" if task.profile else ""
    return f"{task.arena} ({task.world}), {task.episode_steps} decisions{under}"


def _runs_of(runs: Sequence[Run], task: Task) -> dict[str, list[Run]]:
    """Return the runs of a task by system."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        if run.task == task:
            found.setdefault(run.system, []).append(run)
    return found


def _line(name: str, x: Floats, values: Sequence[Floats]) -> Line:
    """Return a line through the interquartile means over runs, `values` [runs][points]."""
    found = band(interquartile_mean, np.array(values))
    return Line(name, x, found.value, found.low, found.high)


def _learned(runs: dict[str, list[Run]]) -> list[Line]:
    lines = []
    for name, own in runs.items():
        curves = [run.curve for run in own if run.curve is not None]
        if curves:
            edges = np.linspace(0.0, min(curve.steps[-1] for curve in curves), CURVE_POINTS + 1)
            lines.append(_line(name, edges[1:], [curve.between(edges) for curve in curves]))
    return lines


def _delivered_by_then(runs: dict[str, list[Run]]) -> list[Line]:
    lines = []
    for name, own in runs.items():
        series = [np.array([0.0, *run.by_then]) for run in own if run.by_then]
        if series and len({len(one) for one in series}) == 1:
            decisions = np.linspace(0.0, own[0].task.episode_steps, len(series[0]))
            lines.append(_line(name, decisions, series))
    return lines


def _shares(runs: dict[str, list[Run]]) -> list[Line]:
    """Return mean Lorenz curves over the episodes of all runs; those in which nobody delivered have none."""
    lines = []
    for name, own in runs.items():
        curves = [
            curve for r in own for episode in r.delivered if (curve := lorenz_curve(episode)) is not None
        ]
        if curves:
            mean = np.mean(curves, axis=0)
            lines.append(Line(name, mean[:, 0], mean[:, 1]))
    return lines


def _touches(runs: dict[str, list[Run]]) -> list[Line]:
    """Return a point for each run, mean touches and mean pellets of its episodes, where both are known."""
    lines = []
    for name, own in runs.items():
        scores = [(run.score(TOUCHES), run.score(PELLETS)) for run in own]
        if known := [(x, y) for x, y in scores if x is not None and y is not None]:
            lines.append(Line(name, *np.array(known).T))
    return lines


def _improvements(rows: Sequence[Row]) -> list[Line]:
    lines = []
    for row in rows:
        if row.improvement is not None:
            low, high = _bounds([row.improvement])
            lines.append(Line(row.system, np.array([row.improvement.value]), np.zeros(1), low, high))
    return lines


def _sizes(comparison: Comparison) -> list[Panel]:
    """Return a panel for each place: a line for each system, a point for each size of the team."""
    places: dict[str, dict[str, list[tuple[int, Estimate]]]] = {}
    for table in comparison.tables:
        systems = places.setdefault(_place(table.task), {})
        for row in table.rows:
            systems.setdefault(row.system, []).append((table.task.robots, row.iqm))
    panels = []
    for place, systems in places.items():
        lines = []
        for name, points in systems.items():
            estimates = [iqm for _, iqm in points]
            robots, values = (
                np.array([float(size) for size, _ in points]),
                np.array([e.value for e in estimates]),
            )
            lines.append(Line(name, robots, values, *_bounds(estimates)))
        panels.append(Panel(place, lines))
    return panels


def _bounds(estimates: Sequence[Estimate]) -> tuple[Floats | None, Floats | None]:
    """Return the bounds of intervals; an estimate without one has its value as both, if others have some."""
    if all(one.low is None for one in estimates):
        return None, None
    low = [one.value if one.low is None else one.low for one in estimates]
    high = [one.value if one.high is None else one.high for one in estimates]
    return np.array(low), np.array(high)


def _profiles(comparison: Comparison) -> list[Line]:
    """Return which share of runs is above each threshold, up to a little beyond the best run."""
    best = max(score for tasks in comparison.normalised.values() for task in tasks for score in task)
    thresholds = np.linspace(0.0, max(1.05, 1.05 * best), _THRESHOLDS)
    lines = []
    for name, tasks in comparison.normalised.items():
        found = performance_profile(tasks, thresholds)
        lines.append(Line(name, thresholds, found.value, found.low, found.high))
    return lines
