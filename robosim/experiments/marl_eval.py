"""The JSON that marl-eval reads (Gorsane 2022, "Towards a Standardised Performance Evaluation Protocol")."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robosim.errors import InputError
from robosim.experiments.runs import PELLETS, Run

POINTS = 20
"""Steps of a learning curve."""

_Runs = Mapping[str, Mapping[str, Sequence[Run]]]
"""Runs by task and system."""


def marl_eval_tables(runs: Sequence[Run], metric: str) -> tuple[dict[str, Any], list[str]]:
    """Return what marl-eval reads of the runs, and sentences on what had to be left out of it.

    `{environment: {task: {system: {run: {step: {"step_count": n, metric: [values]}, ..., "absolute_metrics":
    {metric: [values of episodes]}}}}}}`. It takes for granted that all systems of an environment have equal
    tasks, runs and steps. The steps are those of the learning curve, in pellets in as many decisions as an
    episode has, exploration included; a controller that does not learn has its evaluation at every step. Of
    other figures, and where a run has no curve, there is one step: the evaluation.
    """
    environments: dict[str, dict[str, dict[str, list[Run]]]] = {}
    for run in runs:
        if run.figures.get(metric):
            task = run.task
            place = "-".join([task.arena, task.world, str(task.episode_steps), *filter(None, [task.profile])])
            tasks = environments.setdefault(place, {})
            tasks.setdefault(f"{run.task.robots}-robots", {}).setdefault(_name(run.system), []).append(run)
    tables, notes = {}, []
    for place, tasks in environments.items():
        kept, left = _rectangular(place, tasks)
        notes += left
        if kept:
            tables[place], unequal = _environment(kept, metric)
            if unequal:
                notes.append(f"--marl-eval: {place} has {unequal}.")
    if not tables:
        raise InputError("--marl-eval: no system has runs in all tasks of an arena, as marl-eval needs.")
    return tables, notes


def _name(system: str) -> str:
    """Return the name of a system without commas, which marl-eval refuses."""
    return system.replace(",", ";")


def _rectangular(place: str, tasks: _Runs) -> tuple[dict[str, dict[str, list[Run]]], list[str]]:
    """Return as many runs of each system that has some in all tasks, and what that left out."""
    systems = list(dict.fromkeys(name for task in tasks.values() for name in task))
    whole = [name for name in systems if all(name in task for task in tasks.values())]
    left, notes = [name for name in systems if name not in whole], []
    if left:
        notes.append(
            f"--marl-eval: {place} leaves out {', '.join(left)}, since they lack runs of some tasks."
        )
    alone = [name for name in whole if all(run.team for task in tasks.values() for run in task[name])]
    if any(len(task[name]) > 1 for task in tasks.values() for name in whole if name not in alone):
        # Its one run would leave one of every other system.
        whole = [name for name in whole if name not in alone]
        notes += [
            f"--marl-eval: {place} leaves out {name}, a finished team: it is one run." for name in alone
        ]
    counts = [len(task[name]) for task in tasks.values() for name in whole]
    if whole and max(counts) > min(counts):
        notes.append(
            f"--marl-eval: {place} has the first {min(counts)} seeds of each system, the fewest there are."
        )
    kept = {task: {name: list(own[name])[: min(counts)] for name in whole} for task, own in tasks.items()}
    return (kept if whole else {}), notes


def _environment(tasks: _Runs, metric: str) -> tuple[dict[str, Any], str]:
    """Return the tables of an environment, and which part of the curves they have, if not the whole."""
    runs = [run for task in tasks.values() for own in task.values() for run in own]
    curves = [run.curve for run in runs if run.curve is not None]
    learned = {run.system for run in runs if "algorithm" in run.options}
    with_curves = metric == PELLETS and curves and all(r.curve for r in runs if r.system in learned)
    ends = [float(curve.steps[-1]) for curve in curves] or [1.0]
    last = min(ends)
    edges = np.linspace(0.0, last, POINTS + 1) if with_curves else np.array([0.0, last])
    tables = {
        task: {
            name: {f"run_{number}": _run(run, metric, edges) for number, run in enumerate(own, 1)}
            for name, own in systems.items()
        }
        for task, systems in tasks.items()
    }
    cut = with_curves and max(ends) > last
    return tables, f"curves up to decision {last:.0f}, where the shortest ends" if cut else ""


def _run(run: Run, metric: str, edges: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    episodes = list(run.figures[metric])
    values = [episodes] * (len(edges) - 1)
    if len(edges) > 2 and run.curve is not None:
        values = [[float(one) * run.task.episode_steps / 1000.0] for one in run.curve.between(edges)]
    steps = {
        f"step_{number}": {"step_count": round(float(edge)), metric: value}
        for number, (edge, value) in enumerate(zip(edges[1:], values, strict=True), 1)
    }
    return {**steps, "absolute_metrics": {metric: episodes}}
