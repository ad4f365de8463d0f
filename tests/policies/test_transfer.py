"""The table of teams in both worlds says what evaluations say."""

import runpy
import shutil
import sys
from pathlib import Path

from robosim.control.controller import make_controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.control.policy import find_policy

TOOL = Path(__file__).parents[2] / "tools" / "study_transfer.py"


def mean(controller: str, world: str, steps: int) -> float:
    team = make_controller(controller)
    env = environment_for(team, "paper", 2, world, num_envs=2, seed=3, episode_steps=steps)
    return evaluate(team, env, 2, 3).mean


def test_rows_are_evaluations_of_equal_simulated_time_and_seeds_share_one(
    tmp_path, monkeypatch, capsys
) -> None:
    for seed in (0, 1):
        shutil.copytree(find_policy("paper-2"), tmp_path / f"mine-{seed}")
    runs = [str(tmp_path / f"mine-{seed}") for seed in (0, 1)]
    arguments = ["paper-2", *runs, "--seconds", "150", "--episodes", "2", "--seed", "3"]
    monkeypatch.setattr(sys, "argv", [str(TOOL), *arguments])
    runpy.run_path(str(TOOL), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    cells = []
    for world, steps in (("physics", 500), ("grid", 200)):
        brought, reference = mean("paper-2", world, steps), mean("lanes", world, steps)
        cells.append((f"{brought:.1f}", f"{100 * brought / reference:.0f} %"))
    (physics, share), (grid, grid_share) = cells
    assert lines[2:] == [
        f"| paper-2 | 2 | physics | {physics} | {share} | {grid} | {grid_share} |",
        f"| mine, 2 seeds | 2 | physics | {physics} ± 0.0 | {share} | {grid} ± 0.0 | {grid_share} |",
    ]
