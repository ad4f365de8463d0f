"""Measure what it costs to watch episodes for all metrics of the report.

    python tools/bench_monitor.py [--controller lanes] [--arena paper] [--robots 8] [--envs 5] [--steps 1500]

Makes the same run twice side by side, watched and not, in turns of 20 decisions, and prints the
processor time that watching adds, for three seeds.
"""

from __future__ import annotations

import argparse
import statistics
import time

from robosim.analysis.measure.monitor import TeamMonitor
from robosim.control.controller import make_controller
from robosim.control.environment import environment_for

TURN = 20
SEEDS = (0, 1, 2)


class Run:
    """One evaluation that can be stopped and gone on with."""

    def __init__(self, options: argparse.Namespace, seed: int, monitor: TeamMonitor | None) -> None:
        self.controller = make_controller(options.controller)
        self.env = environment_for(
            self.controller,
            options.arena,
            options.robots,
            num_envs=options.envs,
            seed=seed,
            episode_steps=options.steps,
            autoreset=False,
        )
        self.monitor = monitor
        self.observation = self.env.reset()
        self.controller.reset(self.env)
        self.seconds = 0.0
        if monitor is not None:
            began = time.thread_time()
            monitor.begin(self.env)
            self.seconds += time.thread_time() - began

    def advance(self, decisions: int) -> None:
        began = time.thread_time()
        for _ in range(decisions):
            self.observation = self.env.step(self.controller.act(self.env, self.observation)).observation
            if self.monitor is not None:
                self.monitor.step(self.env)
        self.seconds += time.thread_time() - began

    def end(self) -> None:
        if self.monitor is not None:
            began = time.thread_time()
            self.monitor.end(self.env, self.env.num_envs)
            self.seconds += time.thread_time() - began


def added(options: argparse.Namespace, seed: int) -> float:
    """Return the share of time that watching adds."""
    plain, watched = Run(options, seed, None), Run(options, seed, TeamMonitor())
    for _ in range(options.steps // TURN):
        plain.advance(TURN)
        watched.advance(TURN)
    watched.end()
    return watched.seconds / plain.seconds - 1.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--controller", default="lanes")
    parser.add_argument("--arena", default="paper")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--envs", type=int, default=5)
    parser.add_argument("--steps", type=int, default=1500)
    options = parser.parse_args()
    shares = [added(options, seed) for seed in SEEDS]
    each = ", ".join(f"{100 * share:.1f} %" for share in shares)
    print(f"{options.controller}, {options.arena}, {options.robots} robots, {options.envs} environments:")
    print(f"watching adds {100 * statistics.median(shares):.1f} % (seeds 0 to 2: {each})")


if __name__ == "__main__":
    main()
