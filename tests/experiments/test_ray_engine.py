"""Run where ray is installed: pytest -m slow tests/experiments/test_ray_engine.py."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("ray")

from ray.cluster_utils import Cluster

from robosim.cli.main import main
from robosim.errors import InputError
from robosim.experiments.jobs import Job
from robosim.experiments.local import LocalEngine
from robosim.experiments.ray_engine import RayEngine
from robosim.experiments.results import read_results
from robosim.experiments.runner import run_jobs
from robosim.plugins import VARIABLE
from tests.experiments import cheap
from tests.experiments.test_local import Notes
from tests.processes import hearing_ctrl_c
from tests.test_plugins import PLUGIN

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """Let the processes of Ray find the jobs of the tests."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


def run(tmp_path, configs, work, engine, **options):
    jobs = [Job(config) for config in configs]
    tmp_path.mkdir(exist_ok=True)
    return run_jobs(jobs, work, tmp_path / "jobs", tmp_path / "results.jsonl", engine, **options)


def test_records_are_those_of_the_local_engine(tmp_path):
    configs, notes = [{"x": x} for x in (3, 1, 2)], Notes()
    local = run(tmp_path / "local", configs, cheap.square, LocalEngine(2))
    found = run(tmp_path / "ray", configs, cheap.square, RayEngine(workers=2), watch=notes)
    assert found.results == local.results
    assert found.failures == []
    assert len((tmp_path / "ray" / "results.jsonl").read_text().splitlines()) == 3
    assert sorted(one for one in notes.heard if one[0] == "ended") == [("ended", x, True) for x in "123"]


def test_a_job_whose_process_dies_is_begun_again_and_one_that_fails_is_not(tmp_path):
    configs = [{"how": how} for how in ("killed", "raise", "refuse", "exit", "fine")]
    summary = run(tmp_path, configs, cheap.misbehave, RayEngine(workers=2))
    calls = [result and result.figures["calls"] for result in summary.results]
    assert calls == [(2.0,), None, None, (2.0,), (1.0,)]
    reasons = {failure.job.config["how"]: failure.reason for failure in summary.failures}
    assert reasons.pop("raise").endswith("ZeroDivisionError: a job's own mistake\n")
    assert reasons == {"refuse": "x is 7, but must be 8."}
    assert len(read_results(tmp_path / "results.jsonl")) == 3


def test_a_job_has_one_thread(tmp_path):
    (result,) = run(tmp_path, [{}], cheap.threads, RayEngine(workers=1)).results
    assert set(result.figures.values()) == {(1.0,)}


def test_where_no_cluster_is_there_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match='^no Ray cluster could be reached at "127.0.0.1:1": .*refused.$'):
        run(tmp_path, [{}], cheap.threads, RayEngine("127.0.0.1:1"))


def test_ctrl_c_saves_and_the_same_command_goes_on(tmp_path, capsys):
    path = tmp_path / "long.toml"
    path.write_text(
        '[options]\ntechnique = "iql"\nworld = "grid"\nsteps = 20000\nhidden = [8]\nrobots = 2\n'
        "[evaluation]\nepisodes = 1\nsteps = 50\n"
    )
    command = ["sweep", str(path), "--out", str(tmp_path / "runs"), "--engine", "ray", "--workers", "1"]
    process = subprocess.Popen(hearing_ctrl_c(*command), cwd=ROOT, env=dict(os.environ))
    deadline = time.monotonic() + 120.0
    while not list((tmp_path / "runs").glob("*/work/run/tensorboard/*")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=120) == 130
    (run_folder,) = (tmp_path / "runs").glob("*/work/run")
    assert list((run_folder / "checkpoints").iterdir())
    assert main(command) == 0
    assert "1 run done, 0 skipped" in capsys.readouterr().out


def test_a_clusters_processes_find_code_of_users(tmp_path):
    """The cluster was started without the variable, and elsewhere."""
    (tmp_path / "mine.py").write_text(PLUGIN)
    (tmp_path / "sweep.toml").write_text(
        '[options]\ntechnique = "still"\nworld = "grid"\nrobots = 2\n[evaluation]\nepisodes = 1\nsteps = 20\n'
    )
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        command = [sys.executable, "-m", "robosim", "sweep", "sweep.toml", "--engine", "ray"]
        done = subprocess.run(
            [*command, "--address", cluster.address], cwd=tmp_path, env=os.environ | {VARIABLE: "mine.py"},
            capture_output=True, text=True, check=False, timeout=200,
        )  # fmt: skip
    finally:
        cluster.shutdown()
    assert done.returncode == 0, done.stderr
    (result,) = read_results(tmp_path / "sweep.results.jsonl").values()
    assert result.config["run"]["technique"] == "still"
