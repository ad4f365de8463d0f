"""A training that is watched: the same bits as without, and what it was in a recording."""

from contextlib import closing, contextmanager, nullcontext

import numpy as np
import pytest

from robosim.cli.main import main
from robosim.control.policy import load_policy
from robosim.envs.vector import VectorEnv
from robosim.errors import IncompleteError
from robosim.learning.config import run_config
from robosim.learning.metrics import read_metrics
from robosim.learning.trainer import resume, train
from robosim.playback.training import LiveTraining
from tests.playback.reading import Reading

EPISODE = 40


def learn(folder, watch=None, report=lambda row: None):
    config = run_config(
        robots=2, steps=1000, num_envs=4, episode_steps=EPISODE, evaluation_episodes=0, hidden=(8,), seed=3
    )
    return train(config, folder, report, watch=watch)


def watcher(run, said):
    return LiveTraining(run / "recordings", {"technique": "ps-dqn"}, nullcontext(""), said.append)


def weights(folder):
    return load_policy(folder).weights()


def test_a_training_learns_the_same_whether_it_is_watched_or_not(tmp_path):
    said = []
    watch = watcher(tmp_path / "seen", said)
    learn(tmp_path / "seen", watch)
    watch.close()
    learn(tmp_path / "unseen")
    seen, unseen = weights(tmp_path / "seen"), weights(tmp_path / "unseen")
    assert seen.keys() == unseen.keys()
    assert all(np.array_equal(seen[name], unseen[name]) for name in seen)

    path = tmp_path / "seen" / "recordings" / "live-000000000004.rrd"
    assert said == [str(path)]
    rows = Reading(path).rows
    # The curves are those of the metrics, a point for each row, at the decision of the first environment.
    metrics = read_metrics(tmp_path / "seen" / "metrics.parquet")
    drawn = rows["/learning/reward"]
    assert [value[0] for value in drawn["Scalars:scalars"]] == pytest.approx([row.reward for row in metrics])
    assert "/learning/figures/loss" in rows
    # 250 decisions of the first environment, and a step left out before each of its episodes.
    starts = 1000 // 4 // EPISODE
    assert rows["/plots/tunnel_density"]["step"].max() == 1000 // 4 + starts


def test_where_robots_are_is_what_the_first_environment_says(tmp_path):
    env = VectorEnv("paper", robots=2, num_envs=3, seed=5, episode_steps=4)
    watch, poses = LiveTraining(tmp_path / "out", {}, nullcontext(""), lambda words: None), []
    env.reset()
    generator = np.random.default_rng(0)
    for step in range(10):
        env.step(generator.integers(0, 5, (3, 2)))
        poses.append(env.frame().pose[1, :2].astype(np.float32))
        watch(env, 3 * (step + 1), None)
    watch.close()
    reading = Reading(tmp_path / "out" / "live-000000000003.rrd")
    # Decisions 4 and 8 end episodes: what is seen then are starts, after a step that is left out.
    steps = np.array([1, 2, 3, 5, 6, 7, 8, 10, 11, 12])
    shown = reading.shown("/arena/robots/1", "Transform3D:translation", steps)
    assert np.array([place[0][:2] for place in shown]) == pytest.approx(np.array(poses), abs=2e-3)


def test_a_run_that_is_resumed_is_watched_from_there_on(tmp_path):
    run, said = tmp_path / "run", []
    watch = watcher(run, said)

    def stop(row):
        if row.step >= 500:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(run, watch, stop)
    watch.close()
    again = watcher(run, said)
    resume(run, lambda row: None, watch=again)
    again.close()
    names = sorted(path.name for path in (run / "recordings").iterdir())
    assert names == ["live-000000000004.rrd", "live-000000000504.rrd"]
    learn(tmp_path / "whole")
    seen, whole = weights(run), weights(tmp_path / "whole")
    assert all(np.array_equal(seen[name], whole[name]) for name in seen)


def test_each_stage_of_a_curriculum_is_a_recording_with_its_own_rows(tmp_path):
    run, said = tmp_path / "run", []
    config = run_config(
        "smadrl", robots=3, steps=160, num_envs=2, episode_steps=30, evaluation_episodes=0, hidden=(8,)
    )
    with closing(watcher(run, said)) as watch:
        train(config, run, lambda row: None, watch=watch)
    metrics = read_metrics(run / "metrics.parquet")
    stages = {row.stage: row.robots for row in metrics}
    assert len(said) == len(stages) > 1
    for path, (stage, robots) in zip(said, stages.items(), strict=True):
        rows = Reading(path).rows
        assert len([entity for entity in rows if entity.startswith("/modes/robot_")]) == robots
        drawn = [value[0] for value in rows["/learning/reward"]["Scalars:scalars"]]
        assert drawn == pytest.approx([row.reward for row in metrics if row.stage == stage])


def test_a_recording_that_fails_does_not_end_the_training(tmp_path):
    taken, said = tmp_path / "taken", []
    taken.write_text("")
    watch = LiveTraining(taken, {}, nullcontext(""), said.append)
    assert learn(tmp_path / "run", watch).steps == 1000
    watch.close()
    assert said == [f"{taken}: the recording has ended (File exists); the training goes on."]


@contextmanager
def no_viewer():
    raise IncompleteError("the viewer has failed (exit code 3); what it said is above.")
    yield ""


def test_a_viewer_that_does_not_open_does_not_end_the_training(tmp_path):
    said = []
    watch = LiveTraining(tmp_path / "recordings", {}, no_viewer(), said.append)
    assert learn(tmp_path / "run", watch).steps == 1000
    watch.close()
    why = "the viewer has failed (exit code 3); what it said is above"
    assert said == [f"{tmp_path / 'recordings'}: the recording has ended ({why}); the training goes on."]


def test_teams_that_vary_are_not_watched(tmp_path, capsys):
    command = ["train", "--random-arenas", "10", "--live", "--out", str(tmp_path / "run")]
    assert main(command) == 2
    assert capsys.readouterr().err == (
        "robosim: --live shows one team in one arena: not where arenas and team sizes vary.\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_what_keeps_a_run_from_going_on_opens_no_viewer(tmp_path, capsys):
    run = tmp_path / "none"
    assert main(["train", "--resume", str(run), "--live"]) == 2
    assert capsys.readouterr() == (
        "",
        f"robosim: {run}: no run to resume: there is no config.toml in it.\n",
    )
