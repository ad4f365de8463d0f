"""Measure what the paper leaves open and what our own technique adds, one value at a time.

    python tools/study_learning.py open [--technique iql+s] [--pellet-gradient 0] [--steps 20000] ...
    python tools/study_learning.py ours [--robots 2] [--steps 20000] [--seeds 3] [--workers 2]

`open` changes single values of a configuration, `ours` leaves out single parts of `ps-dqn`. Prints a table
in Markdown: pellets in an episode without exploration, mean over seeds and episodes, the standard
deviation between seeds, and the least of them. Stopped, the same command goes on: runs lie below `--out`,
with a line for each finished one in its results.jsonl.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from robosim.experiments.display import Display
from robosim.experiments.jobs import Job
from robosim.experiments.local import LocalEngine
from robosim.experiments.results import Result
from robosim.experiments.runner import run_jobs
from robosim.experiments.team import Measuring, learning_job, work_off
from robosim.learning.config import DEFAULT_TECHNIQUE, run_config

Changes = dict[str, Any]

OPEN: tuple[Changes, ...] = (
    {},
    *({"updates_per_step": value} for value in (0.125, 1.0)),
    {"target_interval": 400},
    {"replay_capacity": 4000},
    *({"pheromone_decay": value, "pheromone_reinforcement": value} for value in (0.02, 0.4)),
    {"pheromone_radius": 1},
    {"technique": "iql"},
    *({"technique": "iql+gs", "sharing": value} for value in ("copied", "split")),
    {"encoding": "paper"},
)
PARTS: Changes = {"idle_cost": False, "parameters": "own", "normalisation": "none", "mask": False}
"""What `ps-dqn` adds to `iql+s`, left out."""
OURS: tuple[Changes, ...] = (
    {},
    {"pellet_gradient": 0.0},
    *({name: value} for name, value in PARTS.items()),
    {"technique": "iql+s"},
    {"technique": "iql+s", "pellet_gradient": 0.0},
)


def table(variants: Sequence[Changes], results: Sequence[Result | None]) -> Iterator[str]:
    """Yield the lines of the table, for results of all seeds of a variant after those of the one before."""
    yield "| changed | pellets in an episode | between seeds | worst seed |"
    yield "|---|---|---|---|"
    seeds = len(results) // len(variants)
    for number, changes in enumerate(variants):
        found = results[number * seeds : (number + 1) * seeds]
        means = [statistics.mean(result.figures["pellets"]) for result in found if result is not None]
        named = ", ".join(f"`{key}` {value}" for key, value in changes.items()) or "nothing"
        if len(means) < seeds:
            yield f"| {named} | {seeds - len(means)} of {seeds} seeds failed | | |"
            continue
        spread = statistics.stdev(means) if len(means) > 1 else 0.0
        yield f"| {named} | {statistics.mean(means):.1f} | {spread:.1f} | {min(means):.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("study", choices=("open", "ours"))
    parser.add_argument("--technique", default=DEFAULT_TECHNIQUE)
    parser.add_argument("--pellet-gradient", type=float, default=run_config().env.pellet_gradient)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/study"))
    options = parser.parse_args()
    base = {
        "technique": options.technique,
        "robots": options.robots,
        "pellet_gradient": options.pellet_gradient,
        "steps": options.steps,
    }
    variants = OPEN if options.study == "open" else OURS
    labels: dict[str, str] = {}
    jobs: list[Job] = []
    for changes in variants:
        for seed in range(options.seeds):
            jobs.append(learning_job(run_config(**(base | {"seed": seed} | changes)), Measuring()))
            labels[jobs[-1].key] = f"{changes or 'nothing'} seed {seed}"
    with Display(labels, jobs, Console(stderr=True)) as display:
        summary = run_jobs(
            jobs, work_off, options.out, options.out / "results.jsonl", LocalEngine(options.workers), display
        )
    for line in table(variants, summary.results):
        print(line)
    for failure in summary.failures:
        print(f"{failure.job.config}: {failure.reason}", file=sys.stderr)
    if summary.failures:
        sys.exit(1)


if __name__ == "__main__":
    main()
