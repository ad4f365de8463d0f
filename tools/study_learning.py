"""Measure what the paper leaves open, one value at a time, with everything else at its default.

    python tools/study_learning.py [--robots 2] [--steps 20000] [--seeds 3] [--workers 2] [--only NAME]

Prints a table in Markdown: pellets in an episode without exploration, mean over seeds and episodes, and
the standard deviation between seeds.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

from robosim.learning.config import TrainConfig
from robosim.learning.trainer import train

VARIANTS: dict[str, tuple[dict[str, object], ...]] = {
    "default": ({},),
    "updates_per_step": tuple({"updates_per_step": value} for value in (0.125, 1.0)),
    "target_interval": ({"target_interval": 400},),
    "replay_capacity": ({"replay_capacity": 4000},),
    "pheromone_decay": tuple(
        {"pheromone_decay": value, "pheromone_reinforcement": value} for value in (0.02, 0.4)
    ),
    "pheromone_radius": ({"pheromone_radius": 1},),
    "stigmergy": ({"technique": "iql"},),
    "sharing": tuple({"technique": "iql+gs", "sharing": value} for value in ("copied", "split")),
    "encoding": ({"encoding": "paper"},),
}


def pellets(config: TrainConfig) -> float:
    """Return the pellets in an episode, mean over episodes, of a team trained by `config`."""
    with tempfile.TemporaryDirectory() as folder:
        result = train(config, Path(folder) / "run", lambda _: None)
    if result.evaluation is None:
        raise ValueError("the study needs evaluation_episodes")
    return result.evaluation.mean


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", choices=sorted(VARIANTS))
    options = parser.parse_args()
    base = TrainConfig(robots=options.robots, steps=options.steps, checkpoint_every=0)
    names = [options.only] if options.only else list(VARIANTS)
    variants = [(name, changes) for name in names for changes in VARIANTS[name]]
    configs = [
        replace(base, seed=seed, **changes)  # type: ignore[arg-type]
        for _, changes in variants
        for seed in range(options.seeds)
    ]
    print("| changed | pellets in an episode | between seeds |\n|---|---|---|")
    with ProcessPoolExecutor(options.workers) as pool:
        results = pool.map(pellets, configs)
        for _, changes in variants:
            means = [next(results) for _ in range(options.seeds)]
            spread = statistics.stdev(means) if len(means) > 1 else 0.0
            told = ", ".join(f"`{key}` {value}" for key, value in changes.items()) or "nothing"
            print(f"| {told} | {statistics.mean(means):.1f} | {spread:.1f} |", flush=True)


if __name__ == "__main__":
    main()
