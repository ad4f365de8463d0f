"""What an episode draws from its profile is told by every face, kept in trajectories and recordings."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robosim.cli.main import main
from robosim.control.card import Evaluation
from robosim.envs.gym_env import ExcavationEnv
from robosim.envs.parallel import parallel_env
from robosim.envs.profile import load_profile
from robosim.envs.vector import VectorEnv
from robosim.envs.workers import vector_env
from robosim.episodes.replay import replay
from robosim.episodes.trajectory import load_trajectory
from robosim.errors import InputError
from robosim.learning.config import run_config
from robosim.learning.training import evaluation_env, training_env
from tests.playback.reading import Reading

GRID = {"motion": {"latency": (0.5, 2.5), "jitter": 0.5}, "sensing": {"delay": 1, "dropout": 0.1}}


def table(env: VectorEnv, index: int = 0) -> dict:
    assert env.drawn is not None
    return env.drawn[index].table()


def test_every_episode_draws_anew_and_the_batch_tells_what() -> None:
    env = VectorEnv("paper", robots=3, num_envs=2, profile="harsh", episode_steps=1)
    assert env.drawn is None
    env.reset()
    first = table(env, 0), table(env, 1)
    assert first[0] != first[1]
    env.step(np.zeros((2, 3), dtype=int))
    assert table(env, 0) not in first
    again = VectorEnv("paper", robots=3, num_envs=2, profile="harsh")
    again.reset()
    assert (table(again, 0), table(again, 1)) == first
    harsh = load_profile("harsh").motion
    assert all(harsh.latency[0] <= latency <= harsh.latency[1] for latency in first[0]["latency"])
    plain = VectorEnv("paper")
    plain.reset()
    assert plain.drawn is None


def test_what_is_drawn_is_what_the_bodies_are() -> None:
    env = VectorEnv("paper", robots=3, profile="harsh", seed=8)
    env.reset()
    assert env.drawn is not None
    bodies = env.world.spaces[0]._robots
    masses = [body.mass / env.arena.robot.mass for body in bodies]
    assert masses == pytest.approx(env.drawn[0].robot_mass.tolist())


def test_workers_tell_the_draws_of_all_environments() -> None:
    alone = VectorEnv("paper", robots=2, num_envs=2, profile="harsh", seed=3)
    alone.reset()
    with vector_env("paper", robots=2, num_envs=2, profile="harsh", seed=3, workers=2) as env:
        env.reset()
        assert env.drawn is not None
        assert [one.table() for one in env.drawn] == [table(alone, 0), table(alone, 1)]


def test_the_infos_of_a_reset_have_the_draws_of_each_robot() -> None:
    team = parallel_env("paper", robots=3, profile="harsh")
    _, infos = team.reset(seed=5)
    for robot in range(3):
        drawn = infos[f"robot_{robot}"]["drawn"]
        assert drawn == team._batch.drawn[0].of_robot(robot)
        assert len(drawn["wheel_gain"]) == 2
    own = ExcavationEnv("paper", robots=3, profile="harsh")
    assert own.reset(seed=5)[1]["drawn"] == infos["robot_0"]["drawn"]
    assert "drawn" not in ExcavationEnv("paper", robots=3).reset(seed=5)[1]
    json.dumps(infos["robot_1"])


@pytest.mark.parametrize(("profile", "world"), [("harsh", "physics"), (GRID, "grid")])
def test_a_saved_trajectory_runs_again_to_the_bit_under_its_profile(tmp_path: Path, profile, world) -> None:
    env = VectorEnv("paper", robots=3, num_envs=2, seed=5, profile=profile, world=world, episode_steps=40)
    rng = np.random.default_rng(0)
    env.reset()
    frames = []
    for count in range(70):
        env.step(rng.integers(0, 5, (2, 3)))
        if count >= 40:
            frame = env.frame(1)
            frames.append((frame.pose.tobytes(), frame.mode.tobytes(), frame.pheromone.tobytes()))
    env.trajectory(1).save(tmp_path / "run.npz")
    loaded = load_trajectory(tmp_path / "run.npz")
    assert loaded.episode == 1
    assert loaded.drawn == table(env, 1)
    again = [(f.pose.tobytes(), f.mode.tobytes(), f.pheromone.tobytes()) for f in replay(loaded)]
    assert again[1:] == frames


def test_a_trajectory_whose_draws_are_not_those_of_its_seed_is_refused(tmp_path: Path) -> None:
    env = VectorEnv("paper", robots=2, profile="harsh")
    env.reset()
    env.step([[0, 0]])
    kept = env.trajectory()
    wrong = replace(kept, drawn={**kept.drawn, "pellet_mass": 1.0})
    wrong.save(tmp_path / "run.npz")
    with pytest.raises(InputError) as refusal:
        next(replay(load_trajectory(tmp_path / "run.npz"), "run.npz"))
    assert str(refusal.value) == (
        "run.npz: drawn is not what its seed, episode and profile draw here, so it cannot be run again."
    )


def test_a_recording_says_under_which_profile_and_what_was_drawn(tmp_path: Path, capsys) -> None:
    path, kept = tmp_path / "run.rrd", tmp_path / "run.npz"
    options = ["--robots", "2", "--steps", "5", "--seed", "4", "--profile", "harsh"]
    assert main(["play", "lanes", *options, "--save", str(path), "--save-trajectory", str(kept)]) == 0
    told = Reading(path).static["/__properties/profile"]
    drawn = next(json.loads(value[0]) for name, value in told.items() if name.endswith("drawn"))
    assert drawn == load_trajectory(kept).drawn
    text = next(iter(value for name, value in Reading(path).static["/about"].items() if "text" in name))[0]
    assert "- **profile**: harsh" in text
    assert "- **robot 1**: wheels x " in text
    assert main(["play", str(kept), "--profile", "none"]) == 2
    assert capsys.readouterr().err == (
        f"robosim: --profile cannot be given with {kept}: a trajectory runs again just as it was.\n"
    )


def test_training_and_evaluation_choose_separately() -> None:
    config = run_config("iql", robots=2, profile="harsh", evaluation_profile="mocap")
    assert training_env(config, 0, 2).config.profile == load_profile("harsh")
    assert evaluation_env(config, 1, 0).config.profile == load_profile("mocap")
    assert evaluation_env(run_config("iql", profile="harsh"), 1, 0).config.profile is None


def test_evaluate_says_under_which_profile(tmp_path: Path, capsys) -> None:
    command = ["evaluate", "lanes", "--robots", "2", "--episodes", "1", "--steps", "5"]
    assert main([*command, "--profile", "mocap", "--json", str(tmp_path / "out.json")]) == 0
    assert capsys.readouterr().out.startswith("lanes in paper (profile mocap), 2 robots, ")
    found = Evaluation.from_table(json.loads((tmp_path / "out.json").read_text()), "out.json")
    assert found.profile == load_profile("mocap")
    assert main([*command, "--profile", "mocop"]) == 2
    assert capsys.readouterr().err == "robosim: No profile is named 'mocop': did you mean mocap?\n"


def test_evaluate_takes_odometry_with_a_profile_and_without(tmp_path: Path, capsys) -> None:
    command, out = (
        ["evaluate", "lanes", "--robots", "2", "--episodes", "1", "--steps", "4"],
        tmp_path / "o.json",
    )
    assert main([*command, "--profile", "mocap", "--odometry", "0.3", "--json", str(out)]) == 0
    assert capsys.readouterr().out.startswith("lanes in paper (profile mocap, changed), 2 robots, ")
    sensing = Evaluation.from_table(json.loads(out.read_text()), "o.json").profile.sensing
    assert sensing == load_profile("mocap").sensing.changed(odometry=0.3)
    assert main([*command, "--odometry", "0.3"]) == 0
    assert main([*command, "--odometry", "1.5"]) == 2
    assert capsys.readouterr().err == (
        "robosim: profile.sensing.odometry is 1.5, but must be a number above 0 and of at most 1 or None.\n"
    )


def test_train_takes_a_profile_and_changes_of_it(tmp_path: Path, capsys) -> None:
    options = ["--steps", "60", "--num-envs", "2", "--episode-steps", "30", "--warmup", "20", "--hidden", "8"]
    options += ["--evaluation-episodes", "0", "--technique", "iql", "--out", str(tmp_path / "run")]
    options += ["--profile", "harsh", "--sensing-dropout", "0", "--motion-latency", "0", "0.05"]
    assert main(["train", *options]) == 0
    capsys.readouterr()
    from robosim.learning.config import read_config

    profile, harsh = read_config(tmp_path / "run" / "config.toml").env.profile, load_profile("harsh")
    assert profile == harsh.changed(
        name="harsh, changed",
        sensing=harsh.sensing.changed(dropout=0.0),
        motion=harsh.motion.changed(latency=(0.0, 0.05)),
    )
