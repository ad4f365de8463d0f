"""A team of real processes, and what becomes of it when some are killed, when messages are bad, or forged."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        "undisturbed",
        "robot-killed",
        "service-killed",
        "world-killed",
        "all-of-it",
        "two-of-one-name",
        "garbage",
        "emergency-stop",
        "keys",
    ],
)
def test_the_team_goes_on_or_stops_and_nothing_crashes(fault, tmp_path):
    done = subprocess.run(
        [
            sys.executable, ROOT / "tools" / "show_decentralised.py", "faults", "--policy", "paper-4-smadrl",
            "--decisions", "200", "--speed", "2", "--logs", tmp_path, "--only", fault,
        ],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAILED" not in done.stdout
