import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from robosim.arena import load_arena
from robosim.cli.program import hint
from robosim.control.card import Evaluation
from robosim.control.controller import make_controller
from robosim.control.policy import load_policy
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.learning.actors import FrozenTeam, expanded
from robosim.learning.algorithms.protocol import Actors
from robosim.learning.checkpoint import list_checkpoints, read_checkpoint, write_checkpoint
from robosim.learning.config import read_config, run_config, self_contained
from robosim.learning.curriculum import Stage
from robosim.learning.folder import RunFolder
from robosim.learning.loop import StageLoop
from robosim.learning.metrics import MetricsLog, read_metrics
from robosim.learning.technique import TECHNIQUES
from robosim.learning.trainer import resume, train, train_or_resume
from robosim.learning.training import Training, task_of

WALK = run_config(
    "iql+s", steps=3000, num_envs=2, learning_rate=1e-3, discount=0.9, hidden=(32, 32, 32), warmup=200,
    exploration=0.5, target_interval=100, reward_scale=1.0,
)  # fmt: skip
SMALL = {"steps": 240, "num_envs": 2, "episode_steps": 60, "evaluation_steps": 60, "evaluation_episodes": 2}


def short(technique="iql+s", **options):
    """Return the configuration of a run that takes a moment."""
    sooner = {"warmup": 40} if "warmup" in run_config(technique).own_options() else {}
    own = {"hidden": (16, 16, 16)} | sooner
    return run_config(technique, **{**SMALL, **own, **options})


SHORT = short()
MOST = 10**9
"""Bytes, more than any checkpoint here takes."""
CURRICULUM = short("smadrl", steps=800, robots=4, fine_tune=0.2)


def task(config, env, robots=None):
    """Return what the robots of `env` have to learn."""
    stage = Stage("together", env.robots, robots or env.robots, 1.0, explores=True)
    return task_of(env, stage, config.schedule.steps)


def learned(config, env):
    """Return the algorithm, after all the decisions of a configuration in `env`."""
    algorithm = config.algorithm.build(task(config, env), np.random.SeedSequence(0))
    stage = Stage("together", env.robots, env.robots, 1.0, explores=True)
    loop = StageLoop(stage, config.schedule.steps, env, algorithm, None, MetricsLog())
    while not loop.finished:
        loop.advance()
    return algorithm


@pytest.mark.parametrize("return_steps", [1, 3])
def test_learns_to_walk_a_corridor_to_and_fro(corridor, return_steps):
    config = WALK.with_options(return_steps=return_steps)
    team = FrozenTeam(learned(config, corridor(robots=2, num_envs=2)).actors())
    test = corridor(robots=2, num_envs=4, episode_steps=101, seed=1)
    observation = test.reset()
    for _ in range(100):
        observation = test.step(team.act(observation)).observation
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert test.delivered.min() >= 9


def run(folder, config=SHORT):
    rows = []
    return train(config, folder, rows.append, "robosim train --some-flag"), rows


def test_a_run_folder_holds_all_that_came_of_the_run(tmp_path):
    result, rows = run(tmp_path / "run")
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {
        "command.txt", "config.toml", "metrics.parquet", "policy", "evaluation.json", "tensorboard",
        "finished.json",
    }  # fmt: skip
    assert read_config(tmp_path / "run" / "config.toml") == SHORT
    kept = read_metrics(tmp_path / "run" / "metrics.parquet")
    assert [row.step for row in kept] == [row.step for row in rows]
    assert kept[-1].step == 240
    text = (tmp_path / "run" / "evaluation.json").read_text()
    assert Evaluation.model_validate_json(text) == result.evaluation
    assert (result.evaluation.episodes, result.evaluation.episode_steps) == (2, 60)
    card = load_policy(tmp_path / "run").card
    assert card.evaluation == result.evaluation
    assert (card.training.command, card.training.steps) == ("robosim train --some-flag", 240)
    assert card.training.versions["torch"] == torch.__version__
    assert card.training.stages == ()
    with pytest.raises(InputError, match="finished; there is nothing to resume, but a new run"):
        resume(tmp_path / "run", rows.append)


def weights(folder):
    return (folder / "policy" / "policy.safetensors").read_bytes()


def test_a_temperature_changes_how_the_team_acts_and_nothing_that_it_learned(tmp_path):
    settings = {"evaluation_episodes": 2, "evaluation_steps": 40, "steps": 200, "num_envs": 2}
    cold, warm = (
        train(run_config("ps-ippo", robots=2, temperature=temperature, **settings), tmp_path / name, print)
        for name, temperature in (("cold", None), ("warm", 3.0))
    )
    one, other = load_policy(cold.folder), load_policy(warm.folder)
    assert (one.card.network.temperature, other.card.network.temperature) == (None, 3.0)
    restless = train(
        run_config(
            "ps-ippo", robots=2, temperature=3.0, temperature_in_place=9.0, retreat_in_place=8, **settings
        ),
        tmp_path / "restless",
        print,
    )
    third = load_policy(restless.folder)
    assert third.card.network == other.card.network.changed(temperature_in_place=9.0, retreat_in_place=8)
    assert third.card.weights_sha256 == other.card.weights_sha256
    for name, array in one.weights().items():
        assert (array == other.weights()[name]).all()
    env = VectorEnv("paper", num_envs=2, robots=2, seed=3)
    observation = env.reset()
    chosen = [other.act(observation, decision) for decision in range(20)]
    assert len({actions.tobytes() for actions in chosen}) > 5
    with pytest.raises(InputError) as caught:
        train(run_config("madqn", robots=2, temperature=0.5), tmp_path / "joint", print)
    assert str(caught.value) == (
        'temperature is 0.5, but must be absent where output is "joint action values".'
    )
    with pytest.raises(InputError) as caught:
        train(
            run_config("ps-ippo", robots=2, temperature=0.5, temperature_in_place=2.0, encoding="paper"),
            tmp_path / "joint",
            print,
        )
    assert str(caught.value) == (
        "temperature_in_place is 2.0, but must be absent where observations do not say how long a robot has "
        "been in place."
    )
    with pytest.raises(InputError) as caught:
        run_config("ps-ippo", temperature_in_place=2.0)
    assert str(caught.value) == "run: temperature_in_place is 2.0, but must be absent where temperature is."
    assert not (tmp_path / "joint").exists()


def test_equal_runs_end_in_equal_bits_in_another_process_too(tmp_path):
    run(tmp_path / "one")
    program = (
        "import sys; from pathlib import Path; from robosim.learning.config import read_config;"
        "from robosim.learning.trainer import train;"
        "train(read_config(Path(sys.argv[1])), Path(sys.argv[2]), lambda row: None)"
    )
    config = tmp_path / "one" / "config.toml"
    subprocess.run([sys.executable, "-c", program, str(config), str(tmp_path / "two")], check=True)
    assert weights(tmp_path / "one") == weights(tmp_path / "two")
    run(tmp_path / "three", short(seed=1))
    assert weights(tmp_path / "one") != weights(tmp_path / "three")


def test_numpy_policy_acts_as_the_torch_network(tmp_path):
    env = VectorEnv("paper", robots=2, num_envs=3)
    learner = SHORT.algorithm.build(task(SHORT, env), np.random.SeedSequence(3)).learner
    run(tmp_path / "run")
    policy = load_policy(tmp_path / "run")
    learner.load_parameters(policy.weights())
    observation = np.random.default_rng(0).uniform(-1, 1, (500, 2, env.layout.size)).astype(np.float32)
    values = learner.values(observation)
    np.testing.assert_allclose(policy.values(observation), values, rtol=1e-4, atol=1e-5)
    ranked = np.sort(values, axis=-1)
    clear = ranked[..., -1] - ranked[..., -2] > 1e-4
    assert clear.mean() > 0.5
    assert (policy.act(observation) == values.argmax(axis=-1))[clear].all()


def test_an_interrupt_keeps_metrics_and_policy_and_can_be_resumed(tmp_path):
    run(tmp_path / "whole", CURRICULUM)

    def stop(row):
        if row.step >= 480:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(CURRICULUM, tmp_path / "run", stop, "robosim train --some-flag")
    card = load_policy(tmp_path / "run").card
    assert (card.training.steps, card.robots, card.evaluation) == (480, 3, None)
    assert [stage.name for stage in card.training.stages] == ["first team", "newcomer 3"]
    assert read_metrics(tmp_path / "run" / "metrics.parquet")[-1].step == 480
    resume(tmp_path / "run", lambda row: None)
    assert weights(tmp_path / "run") == weights(tmp_path / "whole")
    card = load_policy(tmp_path / "run").card
    assert card.training.command == "robosim train --some-flag"
    assert [(one.name, one.steps, one.ended) for one in card.training.stages] == [
        ("first team", 320, "budget"),
        ("newcomer 3", 160, "budget"),
        ("newcomer 4", 160, "budget"),
        ("fine-tuning", 160, "budget"),
    ]
    figures = [read_metrics(tmp_path / name / "metrics.parquet") for name in ("run", "whole")]
    resumed, whole = (
        [replace(row, steps_per_second=0.0, figures=row.figures | {"loss": 0.0}) for row in rows]
        for rows in figures
    )
    assert resumed == whole
    assert {row.stage for row in whole} == {"first team", "newcomer 3", "newcomer 4", "fine-tuning"}


@pytest.mark.parametrize("newcomer", ["scratch", "copy"])
def test_actors_and_critics_are_resumed_to_the_same_bits_in_every_stage(tmp_path, monkeypatch, newcomer):
    """Also in the midst of a rollout, and in a stage that begins with networks of the one before."""
    config = short(
        "ia2c", robots=3, curriculum=True, newcomer=newcomer, fine_tune=0.2, rollout=7, evaluation_episodes=0
    )
    run(tmp_path / "whole", config)
    advance = Training.advance
    for stop in (50, 150, 182, 222):

        def stopping(training, beside=None, stop=stop):
            if training.step == stop:
                signal.raise_signal(signal.SIGINT)
            return advance(training, beside)

        with monkeypatch.context() as patched:
            patched.setattr(Training, "advance", stopping)
            with pytest.raises(KeyboardInterrupt):
                run(tmp_path / str(stop), config)
        resume(tmp_path / str(stop), lambda row: None)
        assert weights(tmp_path / str(stop)) == weights(tmp_path / "whole")


def test_frozen_robots_keep_their_bits(tmp_path):
    config = CURRICULUM.with_options(fine_tune=0.0)
    run(tmp_path / "four", config)
    # Two robots with what four spend on the first stage: half of the shares.
    run(tmp_path / "two", config.with_options(robots=2, steps=400))
    first, team = (load_policy(tmp_path / name).weights() for name in ("two", "four"))
    for name, array in first.items():
        np.testing.assert_array_equal(array, team[name][:2])
        # Nobody is a copy of anybody.
        assert not np.array_equal(team[name][2], team[name][3])
    # Fine-tuning is what moves them.
    run(tmp_path / "tuned", config.with_options(fine_tune=0.2, steps=1000))
    tuned = load_policy(tmp_path / "tuned").weights()
    for name, array in first.items():
        assert (array != tuned[name][:2]).mean() > 0.2


@pytest.mark.parametrize("options", [{}, {"mask": True}, {"normalisation": "rms", "mask": True}])
def test_frozen_robots_act_as_their_policy_does(tmp_path, options):
    config = short("iql+sc", robots=3, steps=240, evaluation_episodes=0, **options)
    training = Training(config)
    while len(training.ended) < 1:
        training.advance()
    # Two robots with what three spend on the first stage: two of three shares.
    run(tmp_path / "two", config.with_options(robots=2, steps=160))
    policy = load_policy(tmp_path / "two")
    assert policy.card.network.mask == bool(options)
    observation, acted, step = training.env.reset(), [], training.env.step

    def watched(actions):
        acted.append(actions)
        return step(actions)

    training.env.step = watched
    training.loop._observation = observation
    while len(training.ended) < 2 and len(acted) < 20:
        expected = policy.act(training.loop._observation[:, :2])
        training.advance()
        np.testing.assert_array_equal(acted[-1][:, :2], expected)
    assert len(acted) == 20


def test_a_newcomer_can_start_as_a_copy_and_a_run_from_a_policy(tmp_path):
    run(tmp_path / "two", short(evaluation_episodes=0))
    never = short(
        "smadrl", robots=4, newcomer="copy", warmup=10_000, start_from=str(tmp_path / "two"),
        evaluation_episodes=0,
    )  # fmt: skip
    run(tmp_path / "four", never)
    first, team = (load_policy(tmp_path / name).weights() for name in ("two", "four"))
    for name, array in first.items():
        # No update is made, so all newcomers are still the last of the two.
        for robot, original in enumerate((0, 1, 1, 1)):
            np.testing.assert_array_equal(team[name][robot], array[original])
    with pytest.raises(InputError) as caught:
        run(tmp_path / "other", never.with_options(hidden=(8, 8)))
    assert str(caught.value) == (
        f'start_from "{tmp_path / "two"}" has hidden layers [16, 16, 16], but must have [8, 8], as hidden '
        "says."
    )
    with pytest.raises(InputError, match="observation encoding was expanded in training and is paper here"):
        run(tmp_path / "other", never.with_options(encoding="paper"))
    assert not (tmp_path / "other").exists()


def test_one_network_learns_from_what_every_robot_does(corridor):
    config = WALK.with_options(parameters="shared", steps=60)
    env, same = corridor(robots=3, num_envs=2), corridor(robots=3, num_envs=2)
    algorithm = config.algorithm.build(task(config, env), np.random.SeedSequence(0))
    learner = algorithm.learner
    assert learner.shape.robots == 1
    assert learner.settings.batch_size == 3 * config.algorithm.batch_size
    stage = Stage("together", 3, 3, 1.0, explores=True)
    seen, taken, act = [], [], learner.act

    def watched(observation, epsilon):
        assert observation.shape[:2] == (6, 1)
        seen.append(observation[:, 0].copy())
        taken.append(act(observation, epsilon))
        return taken[-1]

    learner.act = watched
    loop = StageLoop(stage, config.schedule.steps, env, algorithm, None, MetricsLog())
    while not loop.finished:
        loop.advance()
    # The same actions, run plainly, give what has been kept, robot by robot.
    observation, rewards = same.reset(), []
    for k, actions in enumerate(taken):
        np.testing.assert_array_equal(seen[k].reshape(2, 3, -1), observation)
        transition = same.step(actions.reshape(2, 3))
        rewards.append(transition.reward)
        observation = transition.observation
    kept = learner.replay.export(0, learner.replay.added)
    settings = config.algorithm
    complete = len(taken) - settings.return_steps + 1
    assert learner.replay.added == 6 * complete
    for k in range(complete):
        total = sum(settings.discount**i * rewards[k + i] for i in range(settings.return_steps))
        rows = np.s_[0, 6 * k : 6 * k + 6]
        np.testing.assert_array_equal(kept["observations"][rows], seen[k])
        np.testing.assert_array_equal(kept["actions"][rows], taken[k][:, 0])
        np.testing.assert_allclose(kept["rewards"][rows], total.ravel(), rtol=1e-5, atol=1e-6)


def test_a_team_with_one_network_is_resumed_to_the_same_bits_and_grows(tmp_path):
    shared = short("ps-dqn", steps=480)
    run(tmp_path / "whole", shared)

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(shared, tmp_path / "run", stop)
    resume(tmp_path / "run", lambda row: None)
    assert weights(tmp_path / "run") == weights(tmp_path / "whole")
    policy = load_policy(tmp_path / "run")
    assert (policy.card.robots, policy.card.network.networks, policy.card.network.shared) == (2, 1, True)
    never = shared.with_options(
        robots=5, warmup=10_000, start_from=str(tmp_path / "run"), evaluation_episodes=0
    )
    run(tmp_path / "five", never)
    grown = load_policy(tmp_path / "five")
    assert (grown.card.robots, grown.card.network.networks) == (5, 1)
    run(tmp_path / "one", never.with_options(robots=1))
    for name, array in policy.weights().items():
        for folder in ("five", "one"):
            np.testing.assert_array_equal(load_policy(tmp_path / folder).weights()[name], array)


MIXED = {
    "arenas": ("paper",), "random_arenas": 2, "team_sizes": (1, 3), "envs_per_arena": 1, "num_envs": 4,
    "episode_steps": 20, "steps": 192, "robots": 3, "updates_per_step": 0.1, "evaluation_episodes": 0,
}  # fmt: skip


def test_teams_of_several_sizes_are_resumed_to_the_same_bits_and_drive_any(tmp_path):
    config = short("ps-dqn", **MIXED)
    result, rows = run(tmp_path / "whole", config)
    # Joint decisions: one in each of four environments, whatever their teams.
    assert (result.steps, rows[-1].step, rows[-1].decisions) == (192, 192, 192)
    assert rows[-1].episode == 4 * (48 // 20)
    training = Training(config)
    # To the algorithm each robot is an environment.
    assert (training.algorithm.task.robots, training.algorithm.task.num_envs) == (1, 8)
    assert training.algorithm.task.decisions == 2 * 192
    for _ in range(27):
        training.advance()
    (tmp_path / "part").mkdir()
    training.save(tmp_path / "part", 0.0)
    again = Training(config)
    again.restore(read_checkpoint(list_checkpoints(tmp_path / "part")[0], MOST), tmp_path / "part")
    for one in (training, again):
        while not one.finished:
            one.advance()
    for name, array in load_policy(tmp_path / "whole").weights().items():
        for one in (training, again):
            np.testing.assert_array_equal(one.actors().weights[name], array)
    card = load_policy(tmp_path / "whole").card
    assert (card.robots, card.network.networks, card.network.shared) == (3, 1, True)
    never = config.with_options(warmup=10**6, start_from=str(tmp_path / "whole"))
    run(tmp_path / "on", never)
    for name, array in load_policy(tmp_path / "whole").weights().items():
        np.testing.assert_array_equal(load_policy(tmp_path / "on").weights()[name], array)


def test_a_run_needs_no_file_of_an_arena_among_several(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(load_arena("s-bend").text)
    run(tmp_path / "run", short("ps-dqn", **{**MIXED, "arenas": ("paper", str(own)), "steps": 8}))
    kept = read_config(tmp_path / "run" / "config.toml").variety
    assert kept.arenas == ("paper", own.read_text())


def test_one_network_for_all_starts_from_one_alone(tmp_path):
    run(tmp_path / "own", short(evaluation_episodes=0))
    start = str(tmp_path / "own")
    with pytest.raises(InputError) as caught:
        run(tmp_path / "no", short("ps-dqn", start_from=start))
    assert str(caught.value) == (
        f'start_from "{start}" has a network for each robot, but must have one for all where parameters is '
        '"shared".'
    )
    assert not (tmp_path / "no").exists()


def test_a_curriculum_goes_on_from_a_team_that_draws_its_actions(tmp_path):
    drawn = {"temperature": 0.5, "temperature_in_place": 2.0, "retreat_in_place": 12}
    run(tmp_path / "two", short("ippo", evaluation_episodes=0, **drawn))
    grown = short("ippo", robots=3, curriculum=True, start_from=str(tmp_path / "two"), evaluation_episodes=0)
    run(tmp_path / "best", grown)
    run(tmp_path / "drawn", grown.with_options(**drawn))
    first, best, draws = (load_policy(tmp_path / name) for name in ("two", "best", "drawn"))
    assert [policy.card.network.temperature for policy in (first, best, draws)] == [0.5, None, 0.5]
    assert draws.card.network.retreat_in_place == 12
    for name, array in first.weights().items():
        # What the frozen robots know does not change, and how the team is to draw changes nothing learned.
        np.testing.assert_array_equal(best.weights()[name][:2], array)
        np.testing.assert_array_equal(draws.weights()[name], best.weights()[name])


def test_a_curriculum_goes_on_from_a_shipped_team_with_its_layers_and_its_mask(tmp_path):
    config = short("smadrl", robots=4, hidden=(128, 128, 128), start_from="paper-2", evaluation_episodes=0)
    run(tmp_path / "run", config)
    card = load_policy(tmp_path / "run").card
    network = card.network
    assert (network.normalisation, network.mask, network.shared) == ("rms", True, False)
    assert [stage.name for stage in card.training.stages] == ["newcomer 3", "newcomer 4"]
    shipped, team = load_policy("paper-2"), load_policy(tmp_path / "run")
    before, after = (expanded(Actors(one.card.network, one.weights())).weights for one in (shipped, team))
    for name, array in before.items():
        np.testing.assert_array_equal(after[name][:2], array)
    observation = VectorEnv("paper", robots=4, num_envs=3).reset()
    np.testing.assert_array_equal(team.act(observation)[:, :2], shipped.act(observation[:, :2]))


def test_a_team_for_other_robots_goes_on_from_one_that_fits_no_longer(tmp_path):
    other = load_arena("paper").text + "\n[robot]\nmass = 0.5\nmax_wheel_speed = 9.0\n"
    config = short("ps-dqn", robots=2, arena=other, evaluation_episodes=0)
    run(tmp_path / "before", short("ps-dqn", robots=2, evaluation_episodes=0))
    env = VectorEnv(other, robots=2)
    env.reset()
    refused = "robot mass was 0.4 in training and is 0.5 here; robot max_wheel_speed was 12.5 in training"
    with pytest.raises(InputError, match=refused):
        make_controller(tmp_path / "before").reset(env)
    run(tmp_path / "other", config.with_options(start_from=str(tmp_path / "before"), warmup=10**6))
    team = load_policy(tmp_path / "other")
    assert (team.card.arena.robot.mass, team.card.arena.robot.max_wheel_speed) == (0.5, 9.0)
    # Before the first update it is the team that it comes from.
    assert weights(tmp_path / "other") == weights(tmp_path / "before")
    make_controller(tmp_path / "other").reset(env)
    blind = config.with_options(start_from=str(tmp_path / "before"), stigmergy=False)
    with pytest.raises(InputError, match="stigmergy was True in training and is False here"):
        run(tmp_path / "blind", blind)


def test_a_run_needs_neither_its_arenas_file_nor_the_folder_it_was_begun_in(tmp_path, monkeypatch):
    options = {"robots": 2, "evaluation_episodes": 0}
    arena = load_arena("single-lane").text
    (tmp_path / "own.toml").write_text(arena)
    run(tmp_path / "before", short("ps-dqn", **options))
    monkeypatch.chdir(tmp_path)
    config = short("ps-dqn", arena="own.toml", start_from="before", steps=480, **options)
    run(tmp_path / "whole", config)

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "run", stop)
    kept = RunFolder(tmp_path / "run").config()
    assert (kept.env.arena, kept.schedule.start_from) == (arena, str(tmp_path / "before"))
    (tmp_path / "own.toml").write_text(load_arena("paper").text)
    # Another team, of other networks, takes the place of the one that the run started from.
    shutil.rmtree(tmp_path / "before")
    run(tmp_path / "before", short("ps-dqn", normalisation="none", mask=False, seed=9, **options))
    monkeypatch.chdir(tmp_path / "run")
    resume(tmp_path / "run", lambda row: None)
    assert weights(tmp_path / "run") == weights(tmp_path / "whole")


def test_without_a_curriculum_no_stage_ends_early(tmp_path):
    config = short("iql+s", steps=1500, steady_gain=10.0, evaluation_episodes=0)
    result, _ = run(tmp_path / "run", config)
    assert result.steps == 1500


def test_acting_beside_learning_changes_no_bit(tmp_path):
    run(tmp_path / "one", CURRICULUM)
    run(tmp_path / "two", CURRICULUM.with_options(overlap=True))
    assert weights(tmp_path / "one") == weights(tmp_path / "two")


def test_playbacks_are_recorded_while_it_learns_and_change_nothing(tmp_path):
    seen = []

    def record(controller, env, path):
        seen.append((path.name, env.robots, env.episode_steps, controller.policy.robots))
        env.reset()
        env.step(controller.act(env, env.reset()))

    run(tmp_path / "one", CURRICULUM)
    # One of them as a stage ends, when the next newcomer has not learned anything yet.
    config = CURRICULUM.with_options(record_every=160, record_steps=7)
    train(config, tmp_path / "two", lambda row: None, record=record)
    robots = {160: 2, 320: 2, 480: 3, 640: 4, 800: 4}
    assert seen == [(f"{step:012d}.rrd", count, 7, count) for step, count in robots.items()]
    assert weights(tmp_path / "one") == weights(tmp_path / "two")


def kill_now(process, seconds):
    process.stdout.readline()
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    return process.returncode


@pytest.mark.slow
def test_killed_ten_times_a_run_ends_in_the_same_bits(tmp_path):
    config = CURRICULUM.with_options(steps=6000, checkpoint_every=100, replay_capacity=300)
    whole = run(tmp_path / "whole", config)[0]
    run_here = [sys.executable, "-m", "robosim", "train", "--resume", str(tmp_path / "run")]
    folder = tmp_path / "run"
    RunFolder(folder).begin(config, "")
    moments = np.random.default_rng(5).uniform(0.0, 0.3, 10)
    for moment in moments:
        process = subprocess.Popen(run_here, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        assert kill_now(process, moment) == -signal.SIGKILL
    # The last kill has left something: otherwise this test would only compare two whole runs.
    assert 0 < read_checkpoint(list_checkpoints(folder / "checkpoints")[0], MOST).step < 6000
    finished = subprocess.run(run_here, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    assert weights(folder) == weights(tmp_path / "whole")
    evaluation = Evaluation.model_validate_json((folder / "evaluation.json").read_text())
    assert evaluation.delivered == whole.evaluation.delivered
    assert not (folder / "checkpoints").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_process_saves_and_says_how_to_go_on(tmp_path, number):
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "robosim", "train", "--out", str(folder), "--steps", "1000000"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.readline()
    process.send_signal(number)
    out, err = process.communicate()
    assert process.returncode == 130
    assert out.splitlines()[-1] == f"Stopped; go on with: {hint('train', '--resume', folder)}"
    assert err == "robosim: interrupted\n"
    taken = read_checkpoint(list_checkpoints(folder / "checkpoints")[0], MOST).step
    assert taken >= 500
    assert load_policy(folder).card.training.steps == taken


def interrupted(folder, config):
    """Leave a run with checkpoints behind."""

    def stop(row):
        if row.step >= 500:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config, folder, stop)
    return list_checkpoints(folder / "checkpoints")


def flip_a_bit(path, bit=None):
    """Change one bit of a file, by default one of those in its middle."""
    data = bytearray(path.read_bytes())
    bit = 4 * len(data) + 3 if bit is None else bit
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param("truncated", marks=pytest.mark.slow),
        "emptied",
        "bit",
        pytest.param("of other networks", marks=pytest.mark.slow),
        "part missing",
        pytest.param("part cut", marks=pytest.mark.slow),
        pytest.param("part's bit", marks=pytest.mark.slow),
        "part a pipe",
    ],
)
def test_a_damaged_checkpoint_is_reported_and_the_one_before_goes_on(tmp_path, damage):
    config = short(steps=700, checkpoint_every=200)
    run(tmp_path / "whole", config)
    folder = tmp_path / "run"
    latest, before = interrupted(folder, config)
    if damage == "truncated":
        latest.write_bytes(latest.read_bytes()[:-100])
    elif damage == "emptied":
        latest.write_bytes(b"")
    elif damage == "bit":
        flip_a_bit(latest)
    elif damage == "of other networks":
        kept = read_checkpoint(latest, MOST)
        tensors = {name: tensor[:1] if tensor.dim() else tensor for name, tensor in kept.tensors.items()}
        write_checkpoint(latest.parent, replace(kept, tensors=tensors))
    else:
        part = latest.parent / read_checkpoint(latest, MOST).parts[-1]
        assert part.name not in read_checkpoint(before, MOST).parts
        if damage == "part cut":
            part.write_bytes(part.read_bytes()[:-10])
        elif damage == "part's bit":
            flip_a_bit(part)
        else:
            part.unlink()
            if damage == "part a pipe":
                os.mkfifo(part)
    heard = []
    resume(folder, lambda row: None, warn=heard.append)
    assert len(heard) == 1
    assert heard[0].endswith(f"Going on from the checkpoint before, at decision {int(before.stem)}.")
    assert weights(folder) == weights(tmp_path / "whole")


def test_nothing_good_to_resume_is_a_sentence_each(tmp_path):
    with pytest.raises(InputError, match=r"nowhere: no run to resume: there is no config.toml in it\.$"):
        resume(tmp_path / "nowhere", lambda row: None)
    paths = interrupted(tmp_path / "run", short(steps=700, checkpoint_every=200))
    for path in paths:
        path.write_bytes(b"nonsense")
    with pytest.raises(InputError) as caught:
        resume(tmp_path / "run", lambda row: None)
    sentences = str(caught.value).splitlines()
    assert len(sentences) == len(paths) == 2
    for sentence, path in zip(sentences, paths, strict=True):
        assert sentence.startswith(f"{path}: not a whole checkpoint (")


@pytest.mark.slow
def test_a_disk_that_is_full_ends_the_run_with_a_sentence_and_keeps_the_checkpoint_before(tmp_path):
    folder = tmp_path / "run"
    paths = interrupted(folder, short(steps=700, checkpoint_every=200))
    # No file may be longer than half a checkpoint: to a program, that is a disk without room.
    most = paths[0].stat().st_size // 2
    program = (
        "import resource, sys; from robosim.cli.main import main;"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({most}, {most}));"
        "sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", program, "train", "--resume", str(folder)]
    stopped = subprocess.run(command, capture_output=True, text=True)
    assert stopped.returncode == 2
    assert stopped.stderr.startswith(f"robosim: {folder}/checkpoints/")
    assert stopped.stderr.endswith(
        "cannot be written: File too large; the checkpoint of decision 500 is kept.\n"
    )
    assert list_checkpoints(folder / "checkpoints") == paths
    resume(folder, lambda row: None)
    run(tmp_path / "whole", short(steps=700, checkpoint_every=200))
    assert weights(folder) == weights(tmp_path / "whole")


def test_a_network_for_the_whole_team_goes_on_with_a_team_of_that_size_alone(tmp_path):
    options = {"steps": 60, "evaluation_episodes": 0, "learning_rate": 1e-8}
    run(tmp_path / "two", short("maa2c", robots=2, **options))
    start = str(tmp_path / "two")
    run(tmp_path / "again", short("maa2c", robots=2, seed=1, start_from=start, **options))
    before, after = (load_policy(tmp_path / name).weights() for name in ("two", "again"))
    for name, array in before.items():
        np.testing.assert_allclose(after[name], array, atol=1e-6)
    with pytest.raises(InputError) as caught:
        run(tmp_path / "no", short("maa2c", robots=3, start_from=start, **options))
    assert str(caught.value) == "start_from holds 2 robots, but must hold the team's 3 without a curriculum."


@pytest.mark.parametrize(("encoding", "actions"), [("paper", "wheels"), ("expanded", "cardinal")])
@pytest.mark.parametrize("technique", sorted(TECHNIQUES))
def test_every_technique_trains_with_both_kinds_of_actions_and_observations(
    tmp_path, technique, encoding, actions
):
    config = short(technique, robots=3, encoding=encoding, actions=actions, steps=120)
    result, rows = run(tmp_path / "run", config)
    assert rows[-1].step >= 120
    card = load_policy(tmp_path / "run").card
    assert (card.technique.name, card.env.encoding, card.env.actions) == (technique, encoding, actions)
    assert card.env.stigmergy is config.env.stigmergy
    assert result.evaluation.robots == 3


def test_sixteen_robots_train(tmp_path):
    run(tmp_path / "run", short(robots=16, steps=60, warmup=20, evaluation_episodes=0))
    assert load_policy(tmp_path / "run").card.robots == 16


def test_a_folder_taken_away_stops_the_run_with_a_sentence(tmp_path):
    folder = tmp_path / "run"
    config = CURRICULUM.with_options(checkpoint_every=200)

    def move_away(row):
        if row.step >= 480 and folder.exists():
            folder.rename(tmp_path / "elsewhere")

    with pytest.raises(InputError) as caught:
        train(config, folder, move_away)
    assert str(caught.value) == (
        f"[Errno 2] No such file or directory: '{folder}/checkpoints'; there is none before."
    )
    run(tmp_path / "whole", config)
    resume(tmp_path / "elsewhere", lambda row: None)
    assert weights(tmp_path / "elsewhere") == weights(tmp_path / "whole")


@pytest.mark.slow
def test_one_and_two_workers_give_the_same_bits_also_after_an_interrupt(tmp_path):
    config = short("smadrl", robots=3, steps=600)
    run(tmp_path / "one", config)

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config.with_options(workers=2), tmp_path / "two", stop)
    assert not multiprocessing.active_children()
    resume(tmp_path / "two", lambda row: None)
    assert weights(tmp_path / "one") == weights(tmp_path / "two")
    assert not multiprocessing.active_children()


def test_a_run_leaves_the_threads_of_torch_as_they_were(tmp_path):
    seen = []
    torch.set_num_threads(2)
    train(short(evaluation_episodes=0), tmp_path / "run", lambda row: seen.append(torch.get_num_threads()))
    assert set(seen) == {1}
    assert torch.get_num_threads() == 2


def test_the_same_call_begins_goes_on_and_finds_that_all_is_done(tmp_path):
    run(tmp_path / "whole")
    folder, said = tmp_path / "parts", []

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_or_resume(SHORT, folder, stop, say=said.append)
    begun = (folder / "config.toml").read_bytes()
    result = train_or_resume(SHORT, folder, say=said.append)
    assert (result.steps, said) == (240, [])
    assert weights(folder) == weights(tmp_path / "whole")
    assert result.evaluation.delivered == RunFolder(tmp_path / "whole").evaluation().delivered
    # A kill between the last record and the removal of checkpoints leaves them.
    (folder / "checkpoints").mkdir(exist_ok=True)
    (folder / "checkpoints" / "000000000240.safetensors").touch()
    before = (folder / "finished.json").read_bytes()
    assert train_or_resume(SHORT, folder, say=said.append) == result
    assert said == [f"{folder}: this run is finished; there is nothing left to do."]
    assert (folder / "finished.json").read_bytes() == before
    assert (folder / "config.toml").read_bytes() == begun
    assert not list_checkpoints(folder / "checkpoints")


@pytest.mark.parametrize(
    ("options", "field", "held", "asked"),
    [
        ({"learning_rate": 1e-4}, "algorithm.learning_rate", "0.001", "0.0001"),
        ({"workers": 2}, "run.workers", "1", "2"),
        ({"keep_distance": 0.3}, "env.keep_distance", "None", "0.3"),
        ({"profile": "robotarium"}, "env.profile", "None", "a table"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("finished", [False, True])
def test_a_folder_with_a_run_of_another_configuration_is_refused(
    tmp_path, options, field, held, asked, finished
):
    folder = RunFolder(tmp_path / "run")
    config = short(learning_rate=1e-3)
    folder.begin(config, "")
    if finished:
        (folder.path / "finished.json").write_text('{"steps": 240, "wall_time": 1.0}')
    before = sorted(path.name for path in folder.path.iterdir())
    with pytest.raises(InputError) as caught:
        train_or_resume(short(**{"learning_rate": 1e-3, **options}), folder.path)
    assert str(caught.value) == (
        f"{folder.path}: {field} is {held} in the run that this folder holds, not {asked}; "
        "a run of its own needs a folder of its own."
    )
    assert sorted(path.name for path in folder.path.iterdir()) == before


def test_a_run_whose_arena_s_file_has_changed_is_another_run(tmp_path):
    arena = tmp_path / "mine.toml"
    arena.write_text(load_arena("paper").text)
    folder = RunFolder(tmp_path / "run")
    folder.begin(self_contained(short(arena=str(arena))), "")
    assert train_or_resume(short(arena=str(arena)), folder.path).steps == 240
    arena.write_text(load_arena("paper").text + "# the same, but for this line\n")
    with pytest.raises(
        InputError, match=r"env\.arena is another in the run that this folder holds; a run of"
    ):
        train_or_resume(short(arena=str(arena)), folder.path)


def test_what_does_not_fit_together_leaves_no_folder_and_a_strange_folder_is_left_alone(tmp_path):
    with pytest.raises(InputError, match="no policy is named 'nobody'"):
        train_or_resume(short(start_from="nobody"), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "notes.txt").touch()
    with pytest.raises(InputError, match="this folder is not empty; a new run needs a new one"):
        train_or_resume(SHORT, tmp_path)
