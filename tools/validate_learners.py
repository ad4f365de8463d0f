"""Compare robosim's algorithms with others' implementations on a standard task, simple_spread of mpe2.

    python tools/validate_learners.py run robosim dqn --seed 0
    python tools/validate_learners.py run stable-baselines3 dqn --seed 0
    python tools/validate_learners.py run epymarl maddpg --seed 0 --epymarl CHECKOUT
    python tools/validate_learners.py report

`run` learns for so many joint decisions, evaluates 100 episodes without exploration, the same for everybody,
and adds a line to the results. It needs mpe2 and the library that it is to run, no other: each library can
have a virtual environment of its own. `report` prints a table in Markdown and draws the figure.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections import defaultdict
from functools import partial
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from validation.spread import difference_to_mpe2, evaluate

RESULTS = Path("docs/results/validation.jsonl")
FIGURE = Path("docs/images/validation.png")
REQUIRED = ("mpe2",)
"""By every run, which compares its environments with it first."""
POINTS = 20
"""Of a learning curve."""
EPISODES, FIRST_SEED = 100, 1_000_000
"""Of the evaluation; training draws from other seeds."""
ROUNDING = 1e-5
"""What observations and rewards may differ from mpe2's, which computes in another order."""


class Library(NamedTuple):
    module: str
    """Whose METHODS and `learn` are run."""
    packages: tuple[str, ...]
    """That it needs, as they are imported."""
    versions: tuple[str, ...]
    """Of which packages are written down."""


LIBRARIES = {
    "robosim": Library("validation.ours", ("robosim", "torch"), ("torch", "numpy", "mpe2")),
    "stable-baselines3": Library(
        "validation.stable_baselines",
        ("stable_baselines3", "gymnasium"),
        ("stable-baselines3", "torch", "numpy", "mpe2"),
    ),
    "epymarl": Library("validation.epymarl", ("torch", "yaml"), ("torch", "numpy", "mpe2")),
}

Line = dict[str, Any]


def run(options: argparse.Namespace) -> None:
    library = LIBRARIES[options.library]
    for package in (*library.packages, *REQUIRED):
        if find_spec(package) is None:
            sys.exit(f"{options.library} needs the package {package}, which is not installed here.")
    if options.library == "epymarl" and not (options.epymarl / "src" / "learners").is_dir():
        sys.exit(f"--epymarl is {options.epymarl}, but must be a checkout of github.com/uoe-agents/epymarl.")
    module = import_module(library.module)
    if options.method not in module.METHODS:
        sys.exit(
            f"{options.library} has no method {options.method} here: it has {', '.join(module.METHODS)}."
        )
    apart = difference_to_mpe2(episodes=4, seed=options.seed)
    if apart > ROUNDING:
        sys.exit(f"the environments differ from those of mpe2 {version('mpe2')} by {apart:.1e}.")
    learn = partial(module.learn, path=options.epymarl) if options.library == "epymarl" else module.learn
    began, computed = time.perf_counter(), time.process_time()
    act, returns, settings = learn(options.method, options.seed, options.decisions)
    took, computed = time.perf_counter() - began, time.process_time() - computed
    final = evaluate(act, EPISODES, FIRST_SEED)
    line: Line = {
        "library": options.library,
        "method": options.method,
        "seed": options.seed,
        "decisions": options.decisions,
        "curve": _curve(returns, options.decisions),
        "final_mean": round(statistics.fmean(final), 3),
        "final_std": round(statistics.stdev(final), 3),
        "episodes": EPISODES,
        "wall_time": round(took, 1),
        "cpu_time": round(computed, 1),
        "machine": f"{_processor()}, {os.cpu_count()} cores",
        "versions": {name: version(name) for name in library.versions},
        "settings": settings,
    }
    options.results.parent.mkdir(parents=True, exist_ok=True)
    with options.results.open("a") as file:
        file.write(json.dumps(line) + "\n")
    print(f"{options.library} {options.method}, seed {options.seed}: {line['final_mean']} in {took:.0f} s")


def _curve(returns: list[float], decisions: int) -> list[tuple[int, float]]:
    """Return points (decisions so far, mean return around them), of the returns on the way."""
    each = decisions / len(returns)
    parts = np.array_split(np.arange(len(returns)), min(POINTS, len(returns)))
    return [
        (round(float(part.mean() + 1) * each), round(float(np.mean([returns[i] for i in part])), 3))
        for part in parts
    ]


def _processor() -> str:
    cpus = Path("/proc/cpuinfo")
    for row in cpus.read_text().splitlines() if cpus.exists() else ():
        if row.startswith("model name"):
            return row.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def report(options: argparse.Namespace) -> None:
    if not options.results.exists():
        sys.exit(f"{options.results}: there are no results yet; `run` makes them.")
    lines = [json.loads(row) for row in options.results.read_text().splitlines()]
    groups: dict[tuple[str, str], list[Line]] = defaultdict(list)
    for line in lines:
        groups[line["method"], line["library"]].append(line)
    methods = list(dict.fromkeys(line["method"] for line in lines))
    print(f"| method | {' | '.join(LIBRARIES)} |\n|{'---|' * (1 + len(LIBRARIES))}")
    for method in methods:
        print(f"| {method} | {' | '.join(_cell(groups.get((method, one), [])) for one in LIBRARIES)} |")
    _draw(groups, methods, options.png)


def _cell(lines: list[Line]) -> str:
    """Return the mean of the seeds' returns with their standard deviation, and how many seeds there were."""
    if not lines:
        return "not run"
    final = [line["final_mean"] for line in lines]
    spread = f" ({statistics.stdev(final):.1f})" if len(final) > 1 else ""
    return f"{statistics.fmean(final):.1f}{spread}, {len(final)}"


def _draw(groups: dict[tuple[str, str], list[Line]], methods: list[str], png: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D

    columns = min(4, len(methods))
    rows = -(-len(methods) // columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(3 * columns, 2.4 * rows),
        sharex=True,
        sharey=True,
        layout="constrained",
        squeeze=False,
    )
    for axis in axes.flat[len(methods) :]:
        axis.set_axis_off()
    for axis, method in zip(axes.flat, methods, strict=False):
        axis.set_title(method, fontsize=9)
        for colour, library in enumerate(LIBRARIES):
            for line in groups.get((method, library), []):
                decisions, means = zip(*line["curve"], strict=True)
                axis.plot(decisions, means, color=f"C{colour}", linewidth=0.9)
                axis.plot(
                    line["decisions"] * 1.03, line["final_mean"], marker="o", markersize=3, color=f"C{colour}"
                )
        axis.tick_params(labelsize=7)
        axis.set_ylim(-40, -12)
    handles = [Line2D([], [], color=f"C{i}", label=name) for i, name in enumerate(LIBRARIES)]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(LIBRARIES), fontsize=8, frameon=False
    )
    figure.supxlabel("joint decisions", fontsize=8)
    figure.supylabel("return of an episode, mean of robots", fontsize=8)
    png.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(png, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--results", type=Path, default=RESULTS)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("run", help="learn once and add a line to the results")
    one.add_argument("library", choices=LIBRARIES)
    one.add_argument("method")
    one.add_argument("--seed", type=int, default=0)
    one.add_argument("--decisions", type=int, default=50_000)
    one.add_argument("--epymarl", type=Path, default=Path("epymarl"), help="checkout of EPyMARL")
    drawn = commands.add_parser("report", help="print the table and draw the figure")
    drawn.add_argument("--png", type=Path, default=FIGURE)
    options = parser.parse_args()
    {"run": run, "report": report}[options.command](options)


if __name__ == "__main__":
    main()
