import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from robosim.control.card import Evaluation
from robosim.control.policy import load_policy
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.learning.config import TrainConfig, read_config
from robosim.learning.metrics import MetricsLog, read_metrics
from robosim.learning.trainer import learn, make_learner, prepare_folder, train

WALK = TrainConfig(
    steps=3000, num_envs=2, learning_rate=1e-3, discount=0.9, hidden=(32, 32, 32), warmup=200,
    exploration=0.5, target_interval=100, reward_scale=1.0,
)  # fmt: skip
SHORT = TrainConfig(
    steps=240,
    robots=2,
    num_envs=2,
    episode_steps=60,
    evaluation_steps=60,
    warmup=40,
    hidden=(16, 16, 16),
    evaluation_episodes=2,
)


@pytest.mark.parametrize("return_steps", [1, 3])
def test_learns_to_walk_a_corridor_to_and_fro(corridor, return_steps):
    config = replace(WALK, return_steps=return_steps)
    env = corridor(robots=2, num_envs=2)
    learner = make_learner(config, env, np.random.SeedSequence(0))
    learn(config, env, learner, MetricsLog(), lambda row: None)
    test = corridor(robots=2, num_envs=4, episode_steps=101, seed=1)
    observation = test.reset()
    for _ in range(100):
        observation = test.step(learner.act(observation, 0.0)).observation
    # The best is a delivery every ten decisions; the first comes after less than a whole trip.
    assert test.delivered.min() >= 9


def run(folder, config=SHORT):
    rows = []
    return train(config, folder, rows.append, "robosim train --some-flag"), rows


def test_a_run_folder_holds_all_that_came_of_the_run(tmp_path):
    result, rows = run(tmp_path / "run")
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names >= {"config.toml", "metrics.parquet", "policy", "evaluation.json"}
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


def weights(folder):
    return (folder / "policy" / "policy.safetensors").read_bytes()


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
    run(tmp_path / "three", replace(SHORT, seed=1))
    assert weights(tmp_path / "one") != weights(tmp_path / "three")


def test_numpy_policy_acts_as_the_torch_network(tmp_path):
    env = VectorEnv("paper", robots=2, num_envs=3)
    learner = make_learner(SHORT, env, np.random.SeedSequence(3))
    run(tmp_path / "run")
    policy = load_policy(tmp_path / "run")
    for layer in range(4):
        learner.parameters.weights[layer].copy_(torch.from_numpy(policy._weights[layer]))
        learner.parameters.biases[layer].copy_(torch.from_numpy(policy._biases[layer]))
    observation = np.random.default_rng(0).uniform(-1, 1, (500, 2, env.layout.size)).astype(np.float32)
    values = learner.values(observation)
    np.testing.assert_allclose(policy.values(observation), values, rtol=1e-4, atol=1e-5)
    ranked = np.sort(values, axis=-1)
    clear = ranked[..., -1] - ranked[..., -2] > 1e-4
    assert clear.mean() > 0.5
    assert (policy.act(observation) == values.argmax(axis=-1))[clear].all()


def test_an_interrupt_keeps_metrics_and_policy_and_passes_on(tmp_path):
    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(SHORT, tmp_path / "run", stop)
    card = load_policy(tmp_path / "run").card
    assert card.training.steps == 240
    assert card.evaluation is None
    assert read_metrics(tmp_path / "run" / "metrics.parquet")[-1].step == 240


def test_a_folder_in_use_or_out_of_reach_is_a_sentence(tmp_path):
    full = tmp_path / "full"
    full.mkdir()
    (full / "notes.txt").write_text("mine")
    file = tmp_path / "file"
    file.write_text("")
    for folder, sentence in (
        (full, "this folder is not empty; a run needs a new one."),
        (file, "this is a file; a run needs a folder."),
        (file / "run", "the run folder cannot be written: Not a directory."),
    ):
        with pytest.raises(InputError) as caught:
            prepare_folder(folder)
        assert str(caught.value) == f"{folder}: {sentence}"
    assert (full / "notes.txt").read_text() == "mine"
