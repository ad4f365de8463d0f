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
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robosim.experiments.jobs import Job, Outcome
from robosim.experiments.local import run_local
from robosim.experiments.results import Result
from robosim.learning.config import DEFAULT_TECHNIQUE, RunConfig, run_config
from robosim.learning.folder import CONFIG_FILE
from robosim.learning.trainer import finished_result, resume, train

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


def learn(config: Mapping[str, Any], folder: Path) -> Outcome:
    """Return the pellets in each episode of a team that is trained, from where an earlier call got to."""
    run = folder / "run"
    result = finished_result(run)
    if result is None and (run / CONFIG_FILE).exists():
        result = resume(run, lambda _: None)
    if result is None:
        result = train(RunConfig.from_table(config, "the job"), run, lambda _: None)
    if result.evaluation is None:
        raise ValueError("the study needs evaluation_episodes")
    return Outcome({"pellets": [float(total) for total in result.evaluation.totals]}, result.wall_time)


def job_of(config: RunConfig) -> Job:
    """Return a configuration as a job."""
    return Job(config.model_dump(mode="json"))


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


def show(ended: int, total: int) -> None:
    print(f"{ended} of {total} runs", file=sys.stderr, flush=True)


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
    jobs = [
        job_of(run_config(**(base | {"seed": seed} | changes)))
        for changes in variants
        for seed in range(options.seeds)
    ]
    summary = run_local(jobs, learn, options.out, options.out / "results.jsonl", options.workers, show)
    for line in table(variants, summary.results):
        print(line)
    for failure in summary.failures:
        print(f"{failure.job.config}: {failure.reason}", file=sys.stderr)
    if summary.failures:
        sys.exit(1)


if __name__ == "__main__":
    main()
