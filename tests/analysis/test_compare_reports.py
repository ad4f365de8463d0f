"""The tool that draws reports below each other runs on real ones."""

import subprocess
import sys
from pathlib import Path

import matplotlib.image
import pytest

from robosim.cli.main import main

TOOL = Path(__file__).parents[2] / "tools" / "compare_reports.py"


@pytest.mark.slow
def test_two_reports_become_one_picture(tmp_path):
    for controller, arena in (("lanes", "paper"), ("active", "single-lane")):
        team = ["evaluate", controller, "--arena", arena, "--robots", "2"]
        assert main([*team, "--episodes", "2", "--steps", "120", "--report", str(tmp_path / controller)]) == 0
    command = [sys.executable, str(TOOL), "lanes", "active", "--png", "both.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert [line.split(":")[:2] for line in done.stdout.splitlines()] == [
        ["lanes", " lanes, paper, 2 robots"],
        ["active", " active, single-lane, 2 robots"],
    ]
    picture = matplotlib.image.imread(tmp_path / "both.png")
    assert picture.shape[1] == 1200
    assert len({tuple(colour) for colour in picture.reshape(-1, picture.shape[-1])[::7]}) > 10
