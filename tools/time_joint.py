"""What choosing among all combinations of a team's actions costs, by the team's size.

    python tools/time_joint.py --algorithm madqn|maa2c [--robots 1 2 3 4 5 6 7 8] [--updates 3]

Medians of the processor time of one thread, and the most memory of a process that does nothing else.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import time
from typing import Any

import numpy as np

from robosim.learning.algorithms.protocol import Experience, Task
from robosim.learning.algorithms.registry import find_algorithm
from robosim.learning.computing import one_thread

ENVS = 8
SIZE = 42
"""Numbers in an observation of the expanded encoding without pheromones."""
ACTIONS = 5
OPTIONS: dict[str, dict[str, Any]] = {
    "madqn": {"warmup": 0, "return_steps": 1, "updates_per_step": 1.0 / ENVS}
}
"""With which a decision of all environments is followed by one update, where that needs any."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--algorithm", choices=("madqn", "maa2c"), required=True)
    parser.add_argument("--robots", type=int, nargs="+", default=list(range(1, 9)), help="sizes of teams")
    parser.add_argument("--updates", type=int, default=3, help="of each")
    options = parser.parse_args()
    print(
        "| robots | combinations | acting, ms | an update, ms | memory, GiB |\n|---|---|---|---|---|",
        flush=True,
    )
    for robots in options.robots:
        # The most memory that a process has used does not fall again: each size has a process of its own.
        work = (options.algorithm, robots, options.updates)
        process = multiprocessing.get_context("spawn").Process(target=_report, args=work)
        process.start()
        process.join()


def _report(name: str, robots: int, updates: int) -> None:
    with one_thread():
        acting, learning = _measure(name, robots, updates)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"| {robots} | {ACTIONS**robots:,} | {acting:.2g} | {learning:.3g} | {memory:.1f} |", flush=True)


def _measure(name: str, robots: int, updates: int) -> tuple[float, float]:
    """Return the medians of the times of a decision and of an update, ms."""
    names = tuple(f"number {i}" for i in range(SIZE))
    algorithm = find_algorithm(name)(**OPTIONS.get(name, {})).build(
        Task(robots, ENVS, names, ACTIONS, "cardinal", 1000), np.random.SeedSequence(0)
    )
    rng, never = np.random.default_rng(0), np.zeros(ENVS, np.bool_)
    acting: list[float] = []
    learning: list[float] = []
    while len(learning) < updates:
        seen = rng.random((ENVS, robots, SIZE), np.float32)
        start = time.process_time()
        action = algorithm.act(seen, 1.0)
        acted = time.process_time()
        acting.append(acted - start)
        figures = algorithm.update(0.0)
        # Before the first update there are none, or they are not numbers.
        if figures and np.isfinite(list(figures.values())).all():
            learning.append(time.process_time() - acted)
        reward = rng.random((ENVS, robots), np.float32)
        algorithm.observe(Experience(seen, action, reward, seen, seen, never, never))
    return 1e3 * float(np.median(acting)), 1e3 * float(np.median(learning))


if __name__ == "__main__":
    main()
