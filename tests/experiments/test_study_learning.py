import importlib.util
import sys
from pathlib import Path

import pytest

from robosim.experiments.jobs import run_job
from robosim.experiments.results import Result
from robosim.learning.config import run_config
from robosim.learning.trainer import train

TOOL = Path(__file__).parents[2] / "tools" / "study_learning.py"
TINY = run_config(
    "iql+s", arena="single-lane", steps=12, robots=1, num_envs=1, episode_steps=8, warmup=4,
    hidden=(8,), checkpoint_every=6, record_every=6, record_steps=1, evaluation_episodes=2,
    evaluation_steps=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("study_learning", TOOL)
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_run_is_a_job_that_goes_on_where_it_was(tmp_path, study):
    job = study.job_of(TINY)
    whole = run_job(job, study.learn, tmp_path / "whole")
    assert len(whole.figures["pellets"]) == 2

    def stop(controller, env, path):
        raise KeyboardInterrupt

    folder = job.folder(tmp_path / "parts") / "work" / "run"
    with pytest.raises(KeyboardInterrupt):
        train(TINY, folder, lambda row: None, record=stop)
    parts = run_job(job, study.learn, tmp_path / "parts")
    assert parts.figures == whole.figures
    weights = [path.read_bytes() for path in sorted(tmp_path.rglob("policy.safetensors"))]
    assert len(weights) == 2
    assert weights[0] == weights[1]
    # Once finished, nothing is learned again.
    again = run_job(job, study.learn, tmp_path / "parts")
    assert again == parts
    assert study.job_of(TINY.with_options(seed=1)).key != job.key


def test_the_table(study):
    def result(*pellets):
        return Result("", {}, {"pellets": pellets}, 0.0, {})

    results = [result(10.0, 20.0), result(21.0, 21.0), result(5.0), None]
    assert list(study.table([{}, {"encoding": "paper", "seed": 1}], results)) == [
        "| changed | pellets in an episode | between seeds | worst seed |",
        "|---|---|---|---|",
        "| nothing | 18.0 | 4.2 | 15.0 |",
        "| `encoding` paper, `seed` 1 | 1 of 2 seeds failed | | |",
    ]


def test_every_variant_is_a_configuration(study):
    for changes in (*study.OPEN, *study.OURS):
        study.run_config(**changes)
