"""Code of users is found by commands and in the processes of a sweep, and no file brings any."""

import json
import os
import subprocess
import sys

import pyarrow.parquet
import pytest

from robosim.plugins import VARIABLE, variable_elsewhere

PLUGIN = '''
from typing import Literal

import numpy as np

from robosim.analysis.measure.metrics import Metric, register_metric
from robosim.control.controller import register_controller
from robosim.discretise.reward import register_reward
from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.registry import register_algorithm
from robosim.learning.technique import Technique, register_technique


@register_algorithm
class OwnConfig(DqnConfig):
    name: Literal["own"] = "own"


class Still:
    name = "still"

    def reset(self, env):
        pass

    def act(self, env, observation):
        return np.full((env.num_envs, env.robots), 4)


def robots(episode):
    """Return how many there are."""
    return float(episode.robots)


register_technique(Technique("mine", "own", {"hidden": (8,)}, about="A trial."))
register_controller("still", Still)
register_metric(Metric("robots there", "", robots))
register_reward("still", lambda outcome: 100.0 * (outcome.actions == 4))
'''
TINY = ["--steps", "40", "--num-envs", "2", "--episode-steps", "20", "--warmup", "4", "--robots", "2"]


@pytest.fixture
def robosim(tmp_path):
    """Run the command in a process of its own, in a folder with the plugin; returns code and output."""
    (tmp_path / "mine.py").write_text(PLUGIN)

    def run(*arguments, plugins="mine.py"):
        done = subprocess.run(
            [sys.executable, "-m", "robosim", *map(str, arguments)],
            cwd=tmp_path, env=os.environ | {VARIABLE: plugins}, capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout, done.stderr

    return run


def test_a_technique_an_algorithm_and_a_controller_of_ones_own_are_swept_in_processes(robosim, tmp_path):
    (tmp_path / "sweep.toml").write_text(
        '[options]\nworld = "grid"\nrobots = 2\nsteps = 40\nnum_envs = 2\nepisode_steps = 20\nwarmup = 4\n'
        '[vary]\ntechnique = ["mine", "still"]\nseed = [0, 1]\n[evaluation]\nepisodes = 1\nsteps = 20\n'
    )
    code, _, said = robosim("sweep", "sweep.toml", "--workers", "2")
    assert code == 0, said
    records = [json.loads(line) for line in (tmp_path / "sweep.results.jsonl").read_text().splitlines()]
    assert sorted(one["config"]["run"]["technique"] for one in records) == ["mine"] * 2 + ["still"] * 2
    assert {one["config"].get("algorithm", {}).get("name") for one in records} == {"own", None}


def test_commands_and_reports_know_them(robosim, tmp_path):
    code, _, said = robosim("train", "--technique", "mine", *TINY, "--evaluation-steps", "20", "--out", "run")
    assert code == 0, said
    assert 'name = "own"' in (tmp_path / "run" / "config.toml").read_text()
    code, out, said = robosim(
        "evaluate", "still", "--robots", "3", "--steps", "20", "--episodes", "1", "--report", "report"
    )
    assert code == 0, said
    assert out.startswith("still in paper, 3 robots, 1 episode of 20 decisions")
    assert "robots there" in (tmp_path / "report" / "index.html").read_text()
    # The team is a team like any other, and needs nothing of its maker's.
    code, _, said = robosim("evaluate", "run", "--steps", "20", "--episodes", "1", plugins="")
    assert code == 0, said


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_reward_of_ones_own_teaches_and_the_team_runs_without_it(robosim, tmp_path, workers):
    """Paid well for standing still, robots do little else, wherever their environments run."""
    learn = "train --technique ps-dqn --world grid --robots 2 --num-envs 4 --steps 400 --warmup 50"
    learn = [*learn.split(), "--workers", workers, "--evaluation-steps", "50", "--extra-reward", "still"]
    learn += ["--out", "run"]
    code, _, said = robosim(*learn, plugins="")
    assert (code, said) == (
        2,
        'robosim: unknown extra reward "still": none is registered (register_reward).\n',
    )
    assert not (tmp_path / "run").exists()
    code, _, said = robosim(*learn)
    assert code == 0, said
    metrics = pyarrow.parquet.read_table(tmp_path / "run" / "metrics.parquet")
    assert metrics["reward"][-1].as_py() > 70.0
    card = json.loads((tmp_path / "run" / "policy" / "card.json").read_text())
    assert card["technique"]["facts"]["extra_reward"] == '"still"'
    assert card["env"]["reward"]["extra"] is None
    code, _, said = robosim("evaluate", "run", "--steps", "20", "--episodes", "1", plugins="")
    assert code == 0, said


@pytest.mark.parametrize(
    ("plugins", "name", "error"),
    [
        ("nosuch", "nosuch", "ModuleNotFoundError"),
        ("mine.py, no.py", "no.py", "FileNotFoundError"),
        ("broken.py", "broken.py", "SyntaxError"),
    ],
)
def test_what_cannot_be_imported_is_a_sentence(robosim, tmp_path, plugins, name, error):
    (tmp_path / "broken.py").write_text("def")
    code, _, said = robosim("technique", "list", plugins=plugins)
    assert code == 2
    assert said.startswith(f'robosim: ROBOSIM_PLUGINS names "{name}", which cannot be imported ({error}: ')
    assert said.count("\n") == 1


def test_a_process_in_another_folder_is_told_whole_paths(monkeypatch, tmp_path):
    monkeypatch.delenv(VARIABLE, raising=False)
    assert variable_elsewhere() == {}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(VARIABLE, "package.mine, own.py ,/else/where.py,")
    assert variable_elsewhere() == {VARIABLE: f"package.mine,{tmp_path}/own.py,/else/where.py"}
