"""`robosim bench`: what a decision costs on this machine, against bare `Space.step`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Bench:
    """Measure the simulator's speed, as ratios against bare physics in the same run."""

    decisions: int = 400
    """Joint decisions that each repeat of a single environment times."""
    json: Path | None = None
    """File to write the figures to."""

    def run(self) -> None:
        """Measure every case and print a line for each as it is done."""
        import json
        import platform

        from robosim.analysis.benchmark import Cost, measure
        from robosim.errors import InputError
        from robosim.files import require_writable, write_whole

        if not 1 <= self.decisions <= 100_000:
            raise InputError(f"--decisions is {self.decisions}; allowed are whole numbers from 1 to 100000.")
        if self.json is not None:
            require_writable(self.json)
        print("arena paper, traffic of `lanes`, processor time of one thread, median of three repeats")
        print("robots  envs  pellets   joint/s   robot-decisions/s   in Space.step   cost / floor")
        costs: list[Cost] = []
        for cost in measure(self.decisions):
            costs.append(cost)
            print(
                f"{cost.robots:6d}{cost.envs:6d}{cost.pellets:9d}{cost.joint_decisions_per_second:10.0f}"
                f"{cost.robot_decisions_per_second:20.0f}{cost.floor_share:15.0%}{cost.ratio:15.2f}",
                flush=True,
            )
        alone = {(cost.robots, cost.envs): cost for cost in costs if cost.pellets}
        for envs in (1, 16):
            many, few = alone[32, envs], alone[8, envs]
            times = few.robot_decisions_per_second / many.robot_decisions_per_second
            print(f"with pellets, {envs} envs: a robot-decision of 32 costs {times:.2f} times one of 8")
        if self.json is not None:
            record = {
                "machine": platform.processor() or platform.machine(),
                "python": platform.python_version(),
                "cases": [cost.as_record() for cost in costs],
            }
            write_whole(self.json, json.dumps(record, indent=2) + "\n")
            print(f"written: {self.json}")
