import json
import shutil
from functools import partial
from hashlib import sha256

import numpy as np
import pytest
import torch

from robosim.analysis.measure.monitor import TeamMonitor
from robosim.cli.main import main
from robosim.control.controller import make_controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.control.policy import find_policy, load_policy, read_policy, save_policy
from robosim.envs.config import EnvConfig
from robosim.errors import InputError
from robosim.experiments.jobs import ignore, run_job
from robosim.experiments.team import Measuring, learning_job, measuring_job, work_off
from robosim.learning.config import EVALUATION_SEED, child_seed, run_config
from robosim.learning.metrics import read_metrics
from robosim.learning.trainer import train

OPTIONS = {
    "world": "grid", "arena": "single-lane", "steps": 600, "robots": 2, "num_envs": 2, "episode_steps": 100,
}  # fmt: skip
TINY = run_config(
    "iql+s", **OPTIONS, warmup=50, hidden=(8,), checkpoint_every=200, record_every=200, record_steps=1,
    evaluation_episodes=3, seed=5,
)  # fmt: skip
MEASURING = Measuring(episodes=3, steps=120)


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """A tiny job worked off: job, record, folder of all jobs, shares that were reported."""
    root, shares = tmp_path_factory.mktemp("jobs"), []
    job = learning_job(TINY, MEASURING)
    return job, run_job(job, work_off, root, shares.append), root, shares


def test_a_job_says_what_is_learned_and_how_it_is_measured_and_nothing_else(learned):
    job, result, _, shares = learned
    assert result.config["run"] == {"technique": "iql+s", "seed": 5}
    assert result.config["evaluation"] == {"episodes": 3, "steps": 120}
    same = TINY.with_options(checkpoint_every=0, record_every=0, workers=2, evaluation_episodes=0)
    assert learning_job(same, MEASURING).key == job.key
    for other in (
        {"seed": 6}, {"steps": 601}, {"pheromone_radius": 1}, {"technique": "mine"}, {"temperature": 0.5},
        {"temperature": 0.5, "temperature_in_place": 2.0}, {"temperature": 0.5, "retreat_in_place": 8},
        {"temperature": 0.5, "retreat_in_place": 8, "retreat_with_pellet": 8},
    ):  # fmt: skip
        assert learning_job(TINY.with_options(**other), MEASURING).key != job.key
    assert learning_job(TINY, Measuring(episodes=4, steps=120)).key != job.key
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(shares) > 10


def test_a_team_that_is_to_draw_its_actions_draws_them_as_it_is_measured(learned, tmp_path):
    _, result, _, _ = learned
    drawing = learning_job(TINY.with_options(temperature=1000.0), MEASURING)
    drawn = run_job(drawing, work_off, tmp_path, ignore)
    assert drawn.config["run"] == {"technique": "iql+s", "seed": 5, "temperature": 1000.0}
    spec = read_policy(drawing.folder(tmp_path) / "work" / "run" / "policy").card.network
    assert spec.temperature == 1000.0
    # What is learned is the same; the team moves about at random, so it meets itself and the walls elsewhere.
    curves = [name for name in result.series if name.startswith("learned")]
    assert curves
    assert all(drawn.series[name] == result.series[name] for name in curves)
    assert drawn.figures["touches"] != result.figures["touches"]


def test_figures_are_those_of_robosim_evaluate(learned, tmp_path, capsys):
    job, result, root, _ = learned
    run = job.folder(root) / "work" / "run"
    seed = child_seed(5, EVALUATION_SEED)
    command = ["evaluate", str(run), "--episodes", "3", "--steps", "120", "--seed", str(seed)]
    assert main([*command, "--json", str(tmp_path / "found.json")]) == 0
    capsys.readouterr()
    found = json.loads((tmp_path / "found.json").read_text())
    assert result.figures["pellets"] == tuple(map(sum, found["delivered"]))
    assert result.series["robot_pellets"] == tuple(n for episode in found["delivered"] for n in episode)
    assert result.figures["touches"] == tuple(found["collisions"])
    # In the grid there are no forces: that a figure is not defined is said by leaving it out.
    assert "wheel_energy" not in result.figures
    assert not (run / "checkpoints").exists() or not any((run / "checkpoints").iterdir())


def test_it_goes_on_where_it_was_to_the_same_bits(learned, tmp_path):
    job, whole, root, _ = learned

    def stop(controller, env, path):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(TINY, job.folder(tmp_path) / "work" / "run", lambda row: None, record=stop)
    parts = run_job(job, work_off, tmp_path)
    assert (parts.figures, parts.series) == (whole.figures, whole.series)
    weights = [next(folder.rglob("policy.safetensors")).read_bytes() for folder in (root, tmp_path)]
    assert weights[0] == weights[1]
    # Once finished, nothing is learned again.
    again = run_job(job, work_off, tmp_path)
    assert (again.figures, again.wall_time) == (parts.figures, parts.wall_time)


def test_the_learning_curve_adds_up_to_what_the_run_wrote_down(learned):
    job, result, root, _ = learned
    rows = read_metrics(job.folder(root) / "work" / "run" / "metrics.parquet")
    steps = np.array(result.series["learned"])
    assert steps[-1] == rows[-1].step == 600
    decisions = np.diff([0, *steps])
    pellets = (np.array(result.series["learned_pellets"]) * decisions / 1000).sum()
    assert pellets == pytest.approx(sum(row.delivered for row in rows), abs=1e-3)
    reward = (np.array(result.series["learned_reward"]) * decisions).sum()
    assert reward == pytest.approx(sum(row.reward * row.decisions for row in rows), rel=1e-4)


def test_where_it_learns_does_not_tell_it_from_others(learned, tmp_path):
    job, result, _, _ = learned
    elsewhere = run_job(job, partial(work_off, device="cpu"), tmp_path)
    assert (elsewhere.key, elsewhere.config, elsewhere.figures) == (result.key, result.config, result.figures)
    assert "gpu" not in elsewhere.machine
    with pytest.raises(InputError, match=r'device is "tpu", but must be "cpu"'):
        run_job(job, partial(work_off, device="tpu"), tmp_path / "tpu")
    # An algorithm without the option learns where it always does.
    other = learning_job(run_config("ps-ippo", **{**OPTIONS, "steps": 200}), MEASURING)
    run_job(other, partial(work_off, device="tpu"), tmp_path / "other")


def test_a_team_that_learned_on_a_gpu_elsewhere_is_measured_here(learned, tmp_path):
    job, result, root, _ = learned
    folder = job.folder(tmp_path)
    shutil.copytree(job.folder(root), folder)
    run = folder / "work" / "run"
    text = (run / "config.toml").read_text()
    assert 'device = "cpu"' in text
    (run / "config.toml").write_text(text.replace('device = "cpu"', 'device = "cuda:97"'))
    finished = json.loads((run / "finished.json").read_text())
    finished["files"]["config.toml"] = sha256((run / "config.toml").read_bytes()).hexdigest()
    (run / "finished.json").write_text(json.dumps(finished))
    there = run_job(job, work_off, tmp_path)
    assert there.figures == result.figures
    assert there.machine["gpu"] == "cuda:97"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_a_record_names_the_gpu(learned, tmp_path):
    job, result, _, _ = learned
    on_gpu = run_job(job, partial(work_off, device="cuda"), tmp_path)
    assert on_gpu.machine == {**result.machine, "gpu": torch.cuda.get_device_name()}


@pytest.mark.parametrize("world", ["grid", "physics"])
def test_a_scripted_team_is_only_measured(tmp_path, world):
    env = EnvConfig(world=world, arena="paper", robots=2)
    result = run_job(measuring_job("lanes", env, 3, Measuring(episodes=2, steps=300)), work_off, tmp_path)
    assert result.wall_time == 0.0
    assert result.evaluation_time > 0.0
    monitor, controller = TeamMonitor(), make_controller("lanes")
    seed = child_seed(3, EVALUATION_SEED)
    environment = environment_for(controller, "paper", 2, world, num_envs=2, seed=seed, episode_steps=300)
    evaluation = evaluate(controller, environment, 2, seed, watch=[monitor])
    assert result.figures["pellets"] == tuple(evaluation.totals)
    assert sum(evaluation.totals) > 0
    first = np.array(evaluation.delivered[0])
    by_then = result.series["pellets_by_then"]
    assert len(by_then) == 50
    assert by_then[-1] == first.sum()
    # The slow way: every delivery by the decision at which a point lies.
    trips = monitor.episodes[0].trips
    assert by_then == tuple(
        float(sum(trip.pellets for trip in trips if trip.end <= round(300 * k / 50))) for k in range(1, 51)
    )
    energies = [episode.totals.energy.sum() for episode in monitor.episodes]
    if world == "physics":
        assert result.figures["wheel_energy"] == pytest.approx(energies, rel=1e-5)
    assert set(result.figures["clogs"]) <= {0.0, 1.0, 2.0, 3.0}


def test_what_no_episode_defines_is_left_out_and_what_some_define_has_theirs(tmp_path):
    env = EnvConfig(world="grid", robots=1)
    result = run_job(measuring_job("lanes", env, 0, Measuring(episodes=1, steps=20)), work_off, tmp_path)
    assert "gini" not in result.figures
    assert result.figures["pellets"] == (0.0,)
    assert len(result.series["pellets_by_then"]) == 20


def test_a_policy_that_is_replaced_meanwhile_is_not_taken_for_the_one_that_is_meant(learned, tmp_path):
    job, _, root, _ = learned
    start = tmp_path / "start"
    shutil.copytree(job.folder(root) / "work" / "run" / "policy", start)
    going_on = learning_job(TINY.with_options(start_from=str(start)), MEASURING)
    measured = measuring_job(f"policy:{start}", TINY.env, 0, MEASURING)
    assert going_on.config["start_weights"] == measured.config["weights"]
    assert run_job(going_on, work_off, tmp_path / "jobs").series["learned"][-1] == 600.0
    policy = load_policy(start)
    save_policy(start, {name: array + 1.0 for name, array in policy.weights().items()}, policy.card)
    for one in (going_on, measured):
        with pytest.raises(InputError) as caught:
            run_job(one, work_off, tmp_path / "jobs")
        assert str(caught.value) == (
            f'"{start}" has become another policy since the sweep began: begin the sweep again.'
        )


def test_a_policy_without_weights_is_a_sentence(tmp_path):
    shutil.copytree(find_policy("paper-2"), tmp_path / "start")
    weights = tmp_path / "start" / "policy.safetensors"
    weights.unlink()
    with pytest.raises(InputError) as caught:
        measuring_job(f"policy:{tmp_path / 'start'}", EnvConfig(robots=2), 0, MEASURING)
    assert str(caught.value) == f"{weights}: there is no such weights file."


def test_a_trained_policy_is_measured_by_name_and_known_by_its_weights(tmp_path):
    env = EnvConfig(world="grid", robots=2)
    job = measuring_job("policy:paper-2", env, 0, Measuring(episodes=1, steps=50))
    assert len(job.config["weights"]) == 16
    assert run_job(job, work_off, tmp_path).config["run"]["technique"] == "policy:paper-2"
    with pytest.raises(InputError, match="no policy is named 'paper-200'"):
        measuring_job("policy:paper-200", env, 0, Measuring())
