"""Measure what recording costs: time added to a run, and bytes per robot and decision.

    python tools/bench_playback.py [--arena paper --robots 8 --steps 5000 --rounds 3 --json FILE]

The same run is made twice side by side, with and without a recorder, in turns of a few decisions, so that
whatever else the machine does meets both alike. The time of the recorded run includes opening the file and
writing its end.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv
from robosim.playback import recording

TURN = 20
"""Decisions of one run before it is the other's turn."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arena", default="paper")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rounds = [measure(args.arena, args.robots, args.steps, seed) for seed in range(args.rounds)]
    result = {
        "arena": args.arena,
        "robots": args.robots,
        "steps": args.steps,
        "rounds": args.rounds,
        **{name: statistics.median(one[name] for one in rounds) for name in rounds[0]},
    }
    text = json.dumps(result, indent=2)
    print(text)
    if args.json:
        args.json.write_text(text + "\n")


def measure(arena: str, robots: int, steps: int, seed: int) -> dict[str, float]:
    plain, recorded = Run(arena, robots, steps, seed), Run(arena, robots, steps, seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        started = time.perf_counter()
        context = recording(path, recorded.env.arena, robots=robots)
        recorder = context.__enter__()
        opening = time.perf_counter() - started
        adding = 0.0

        def add() -> None:
            nonlocal adding
            before = time.perf_counter()
            recorder.add(recorded.env.frame())
            adding += time.perf_counter() - before

        for first in range(0, steps, TURN):
            count = min(TURN, steps - first)
            plain.take(count, lambda: None)
            recorded.take(count, add)
        before = time.perf_counter()
        context.__exit__(None, None, None)
        closing = time.perf_counter() - before
        size = path.stat().st_size
    with_recording = recorded.seconds + opening + closing
    return {
        "run_us_per_decision": 1e6 * plain.seconds / steps,
        "recorded_run_us_per_decision": 1e6 * with_recording / steps,
        "added_percent": 100.0 * (with_recording / plain.seconds - 1.0),
        "adding_us_per_decision": 1e6 * adding / steps,
        "opening_and_closing_ms": 1e3 * (opening + closing),
        "recorder_percent": 100.0 * (adding + opening + closing) / plain.seconds,
        "bytes_per_robot_and_decision": size / robots / steps,
    }


class Run:
    """One run of the lane keeper, and the time that it took so far."""

    def __init__(self, arena: str, robots: int, steps: int, seed: int) -> None:
        self.env = VectorEnv(arena, robots=robots, seed=seed, episode_steps=steps, autoreset=False)
        self.controller = LanesController()
        self.observation = self.env.reset()
        self.controller.reset(self.env)
        self.seconds = 0.0

    def take(self, count: int, after: Callable[[], None]) -> None:
        started = time.perf_counter()
        for _ in range(count):
            self.observation = self.env.step(self.controller.act(self.env, self.observation)).observation
            after()
        self.seconds += time.perf_counter() - started


if __name__ == "__main__":
    main()
