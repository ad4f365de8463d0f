"""Measure what the paper leaves open and what our own technique adds, one value at a time.

    python tools/study_learning.py open [--technique iql+s] [--pellet-gradient 0] [--steps 20000] ...
    python tools/study_learning.py ours [--robots 2] [--steps 20000] [--seeds 3] [--workers 2]

`open` changes single values of a configuration, `ours` leaves out single parts of `ps-dqn`. Prints a table
in Markdown: pellets in an episode without exploration, mean over seeds and episodes, the standard
deviation between seeds, and the least of them.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from robosim.learning.config import TrainConfig
from robosim.learning.technique import TECHNIQUES, find_technique
from robosim.learning.trainer import train

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
SWITCHES = ("idle_cost", "parameter_sharing", "normalised", "action_mask")
"""What `ps-dqn` adds to `iql+s`."""
OURS: tuple[Changes, ...] = (
    {},
    {"pellet_gradient": 0.0},
    *({"technique": f"ps-dqn without {switch}"} for switch in SWITCHES),
    {"technique": "iql+s"},
    {"technique": "iql+s", "pellet_gradient": 0.0},
)

# Beside those that users may name; worker processes import this module and know them too.
for _switch in SWITCHES:
    _name = f"ps-dqn without {_switch}"
    TECHNIQUES[_name] = replace(find_technique("ps-dqn"), name=_name, **{_switch: False})


def pellets(config: TrainConfig) -> float:
    """Return the pellets in an episode, mean over episodes, of a team trained by `config`."""
    with tempfile.TemporaryDirectory() as folder:
        result = train(config, Path(folder) / "run", lambda _: None)
    if result.evaluation is None:
        raise ValueError("the study needs evaluation_episodes")
    return result.evaluation.mean


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("study", choices=("open", "ours"))
    parser.add_argument("--technique", default=TrainConfig().technique)
    parser.add_argument("--pellet-gradient", type=float, default=TrainConfig().pellet_gradient)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    base = TrainConfig(
        robots=options.robots,
        technique=options.technique,
        pellet_gradient=options.pellet_gradient,
        steps=options.steps,
        checkpoint_every=0,
    )
    variants = OPEN if options.study == "open" else OURS
    configs = [replace(base, seed=seed, **changes) for changes in variants for seed in range(options.seeds)]
    print("| changed | pellets in an episode | between seeds | worst seed |\n|---|---|---|---|")
    with ProcessPoolExecutor(options.workers) as pool:
        results = pool.map(pellets, configs)
        for changes in variants:
            means = [next(results) for _ in range(options.seeds)]
            spread = statistics.stdev(means) if len(means) > 1 else 0.0
            told = ", ".join(f"`{key}` {value}" for key, value in changes.items()) or "nothing"
            print(f"| {told} | {statistics.mean(means):.1f} | {spread:.1f} | {min(means):.1f} |", flush=True)


if __name__ == "__main__":
    main()
