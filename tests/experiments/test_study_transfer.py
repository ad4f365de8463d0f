"""The table of teams in both worlds says what evaluations say."""

import importlib.util
import runpy
import shutil
import sys
from pathlib import Path

import pytest

from robosim.arena import load_arena
from robosim.control.controller import make_controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.control.policy import find_policy
from robosim.learning.config import run_config
from robosim.learning.trainer import train

TOOL = Path(__file__).parents[2] / "tools" / "study_transfer.py"


def mean(controller: str, world: str, steps: int) -> float:
    team = make_controller(controller)
    env = environment_for(team, "paper", 2, world, num_envs=2, seed=3, episode_steps=steps)
    return evaluate(team, env, 2, 3).mean


@pytest.mark.slow
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


def test_a_team_of_an_own_arena_is_measured_in_both_worlds(tmp_path):
    spec = importlib.util.spec_from_file_location("study_transfer", TOOL)
    study = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(study)
    own = tmp_path / "own.toml"
    own.write_text(load_arena("single-lane").text.replace('name = "single-lane"', 'name = "mine"'))
    config = run_config(
        "iql+s", arena=str(own), steps=4, robots=1, num_envs=1, hidden=(8,), evaluation_episodes=0
    )
    train(config, tmp_path / "team-0", lambda row: None)
    (row,) = study.rows([str(tmp_path / "team-0")], study.Settings(seconds=3.0, episodes=1, seed=1))
    # In so short a time nobody delivers: there is no share of nothing.
    assert row == "| team-0 | 1 | physics | 0.0 | - | 0.0 | - |"
