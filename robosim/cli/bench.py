"""`robosim bench`: what decisions and updates cost on this machine, against their bare work."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robosim.cli.progress import each, progress


@dataclass(frozen=True)
class Bench:
    """Measure the speed of simulator and learner against bare physics and bare matrix products.

    The two worlds are compared too.
    """

    decisions: int = 400
    """Joint decisions that each repeat of a single environment times."""
    updates: int = 200
    """Updates of the learner that each case times."""
    json: Path | None = None
    """File to write the figures to."""

    def run(self) -> None:
        """Measure every case and print a line for each as it is done."""
        import json
        import platform

        from robosim.errors import whole_number
        from robosim.files import require_writable, write_whole

        whole_number("--decisions", self.decisions, 1, 100_000)
        whole_number("--updates", self.updates, 1, 100_000)
        if self.json is not None:
            require_writable(self.json)
        record = {
            "machine": platform.processor() or platform.machine(),
            "python": platform.python_version(),
            "cases": _measure_decisions(self.decisions),
            "worlds": _compare_worlds(self.decisions),
            "learner": measure_learner(self.updates),
        }
        if self.json is not None:
            write_whole(self.json, json.dumps(record, indent=2) + "\n")
            print(f"written: {self.json}")


def measure_learner(updates: int) -> dict[str, Any] | None:
    """Measure updates and print their table; None, and a line that says so, without torch."""
    from importlib.util import find_spec

    if find_spec("torch") is None:
        print("learner: not measured, since torch is not installed (extra `train`)")
        return None
    return _measure_updates(updates)


def _measure_decisions(decisions: int) -> list[dict[str, Any]]:
    from robosim.bench.decisions import ENVS, ROBOTS, Cost, measure

    print("arena paper, traffic of `lanes`, processor time of one thread, median of three repeats")
    print("robots  envs  pellets   joint/s   robot-decisions/s   in Space.step   cost / floor")
    costs: list[Cost] = []
    for cost in each("measuring decisions", measure(decisions), 2 * len(ROBOTS) * len(ENVS)):
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
    return [cost.as_record() for cost in costs]


def _compare_worlds(decisions: int) -> list[dict[str, Any]]:
    from robosim.bench.worlds import TURNS, compare_worlds

    print()
    print(f"worlds: arena paper, traffic of `lanes`, processor time of one thread, median of {TURNS} turns")
    print("world     robots  envs   joint/s")
    with progress("comparing worlds"):
        costs = compare_worlds(decisions)
    for cost in costs:
        rate = cost.joint_decisions_per_second
        print(f"{cost.world:<10}{cost.robots:6d}{cost.envs:6d}{rate:10.0f}", flush=True)
    physics, grid = costs
    times = grid.joint_decisions_per_second / physics.joint_decisions_per_second
    print(f"the grid takes {times:.1f} times as many joint decisions a second")
    return [cost.as_record() for cost in costs]


def _measure_updates(updates: int) -> dict[str, Any]:
    from robosim.learning.benchmark import (
        TEAM,
        compare_with_stable_baselines3,
        measure_one_for_all,
        measure_updates,
    )

    widths = "-".join(map(str, (TEAM.inputs, *TEAM.hidden, TEAM.outputs)))
    print()
    print(f"learner: {TEAM.robots} networks {widths}, processor time of one thread, median of turns")
    print("batch   precision   update us   products us   cost / products   cost / robots one by one")
    records = []
    for cost in each("measuring updates", measure_updates(updates)):
        records.append(cost.as_record())
        print(
            f"{cost.batch_size:5d}   {cost.precision:<9}{cost.seconds * 1e6:12.0f}"
            f"{cost.products_seconds * 1e6:14.0f}{cost.ratio:18.2f}{cost.team_share:27.2f}",
            flush=True,
        )
    with progress("measuring one network for all"):
        one = measure_one_for_all(updates)
    print(
        f"one network for all of them, normalised and masked, batch {one.batch_size}: "
        f"{one.seconds * 1e6:.0f} us, {one.ratio:.2f} times its products"
    )
    with progress("comparing with stable-baselines3"):
        other = compare_with_stable_baselines3(updates)
    if other is None:
        print("stable-baselines3 is not installed: no comparison with its DQN")
    else:
        print(
            f"batch {other.batch_size}: {other.robot_updates_per_second:.0f} robot-updates/s, "
            f"{other.ratio:.1f} times the {other.other_updates_per_second:.0f} of DQN in "
            f"stable-baselines3 {other.version}"
        )
    return {
        "updates": records,
        "one_for_all": one.as_record(),
        "stable_baselines3": other and other.as_record(),
    }
