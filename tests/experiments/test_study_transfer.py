import importlib.util
import sys
from pathlib import Path

from robosim.arena import load_arena
from robosim.learning.config import run_config
from robosim.learning.trainer import train

TOOL = Path(__file__).parents[2] / "tools" / "study_transfer.py"


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
