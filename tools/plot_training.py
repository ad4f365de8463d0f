"""Draw what teams delivered as they learned, from the metrics of one or more runs.

    python tools/plot_training.py RUN... --png training.png

Of a curriculum it also prints what the second half of each stage was like, exploration included.
"""

from __future__ import annotations

import argparse
from itertools import groupby, pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np

from robosim.envs.config import MOST_CONFIG
from robosim.learning.folder import CONFIG_FILE, METRICS_FILE
from robosim.learning.metrics import Metrics, read_metrics
from robosim.texts import read_toml

WINDOW = 20
"""Rows of the metrics that a point is the mean of."""


def curve(rows: list[Metrics]) -> tuple[np.ndarray, np.ndarray]:
    """Return joint decisions and pellets in 1000 of them, smoothed."""
    pellets = np.array([1000.0 * row.delivered / row.decisions for row in rows])
    window = min(WINDOW, len(rows))
    smooth = np.convolve(pellets, np.full(window, 1.0 / window), mode="valid")
    return np.array([row.step for row in rows[window - 1 :]]), smooth


def label_of(path: Path) -> str:
    """Return what a run is called in the legend.

    By its file alone: a technique or an algorithm of one's own is registered where it learned, but not here.
    """
    tables = read_toml(path, MOST_CONFIG, "run configuration")
    env, run = tables["env"], tables["run"]
    return f"{run['technique']}, {env['robots']} robots, seed {run['seed']}"


def print_stages(rows: list[Metrics]) -> None:
    """Print pellets in 1000 decisions and the share of blocked robots, stage by stage."""
    for name, group in groupby(rows, key=lambda row: row.stage):
        stage = list(group)
        half = [row for row in stage if row.stage_step > stage[-1].stage_step / 2]
        decisions = sum(row.decisions for row in half)
        pellets = 1000.0 * sum(row.delivered for row in half) / decisions
        blocked = sum(row.blocked * row.decisions for row in half) / decisions
        print(f"  {name:12} {stage[0].robots} robots  {pellets:5.1f} pellets/1000  {blocked:4.0%} blocked")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--png", type=Path, default=Path("training.png"))
    options = parser.parse_args()
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    for run in options.runs:
        rows, label = read_metrics(run / METRICS_FILE), label_of(run / CONFIG_FILE)
        (line,) = axes.plot(*curve(rows), label=label, linewidth=1.5)
        begins = [row.step for before, row in pairwise(rows) if row.stage != before.stage]
        if begins:
            print(f"{run}:")
            print_stages(rows)
        for step in begins:
            axes.axvline(step, color=line.get_color(), alpha=0.35, linewidth=0.8, linestyle=":")
    axes.set_xlabel("joint decisions")
    axes.set_ylabel("pellets in 1000 decisions, exploration included")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(options.png, dpi=110)
    print(f"{options.png}: {len(options.runs)} runs; dotted lines are where a newcomer joins")


if __name__ == "__main__":
    main()
