"""BenchMARL needs an older torchrl than the rest of the tests: it runs in an environment of its own."""

import csv
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
"""An environment of its own is made, of some hundred megabytes; `make test-slow` runs this."""

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def python(tmp_path_factory) -> Path:
    """An interpreter that has robosim, BenchMARL, and the torchrl that it needs."""
    folder = tmp_path_factory.mktemp("benchmarl")
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    # The one that all is tested with: pip would take the newest, of a gigabyte.
    torch = re.search(r"^torch==.*$", (ROOT / "constraints.txt").read_text(), flags=re.MULTILINE)[0]
    needed = [ROOT, torch, "benchmarl>=1.5,<2", "torchrl<0.12", "tensordict<0.12"]
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*install, *needed], check=True)
    return python


def test_benchmarl_learns_and_evaluates_and_logs_pellets(python: Path, tmp_path: Path) -> None:
    small = ["--frames", "80", "--envs", "4", "--episode-steps", "10", "--out", tmp_path / "run"]
    script = [python, ROOT / "examples" / "benchmarl_mappo.py", *small]
    run = subprocess.run(script, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr
    logged = {path.stem: list(csv.reader(path.open())) for path in (tmp_path / "run").rglob("*.csv")}
    assert [float(value) for _, value in logged["counters_total_frames"]] == [40.0, 80.0]
    assert [float(value) for _, value in logged["collection_delivered"]] == [0.0, 0.0]
    assert len(logged["eval_reward_episode_reward_mean"]) == 2


def test_the_batch_keeps_its_specs_on_the_older_torchrl(python: Path) -> None:
    code = (
        "import torchrl; from torchrl.envs import check_env_specs; "
        "from robosim.learning.faces.torchrl import ExcavationTorchEnv; "
        "check_env_specs(ExcavationTorchEnv('paper', num_envs=3, robots=2, episode_steps=6), seed=0); "
        "print(torchrl.__version__)"
    )
    run = subprocess.run([python, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert run.stdout.splitlines()[-1].startswith("0.11.")
