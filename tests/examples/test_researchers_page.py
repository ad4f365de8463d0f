"""The Python of docs/researchers.md runs as it stands, block after block, with smaller sizes."""

import re

import numpy as np
import pytest

import robosim
from robosim.cli.main import main
from robosim.learning.trainer import resume

SMALLER = {
    "DECISIONS = 5000": "DECISIONS = 40",
    "BUDGET = 100_000": "BUDGET = 240",
    "STEPS = 30_000": "STEPS = 240",
}


@pytest.fixture
def page(examples):
    text = (examples.parent / "docs" / "researchers.md").read_text(encoding="utf-8")
    for size, smaller in SMALLER.items():
        assert len(re.findall(rf"^{size}\b", text, flags=re.MULTILINE)) == 1
        text = re.sub(rf"^{size}\b", smaller, text, flags=re.MULTILINE)
    return text


@pytest.fixture
def run_folder(examples, tmp_path, monkeypatch):
    """The runs of a folder to work in, with the one that the page begins with, of next to no skill."""
    from saving import save_team
    from training_loop import learn

    from robosim.learning import technique
    from robosim.learning.algorithms import registry

    monkeypatch.chdir(tmp_path)
    # The page adds techniques and an algorithm; no other test is to see them.
    monkeypatch.setattr(technique, "TECHNIQUES", dict(technique.TECHNIQUES))
    monkeypatch.setattr(registry, "_REGISTERED", dict(registry._REGISTERED))
    env = robosim.vector_env("paper", robots=2, num_envs=8, reward="local", episode_steps=60)
    weights = learn(env, steps=240, seed=0).parameters.to_numpy()
    folder = tmp_path / "runs" / "a" / "policy"
    save_team(folder, weights, env, "iql+s", seed=0, steps=240, wall_time=1.0)
    return tmp_path / "runs"


def test_the_python_runs_and_leaves_a_policy_for_evaluate_and_play(page, run_folder, capsys) -> None:
    blocks = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    assert len(blocks) == 7
    names: dict[str, object] = {}
    for number, block in enumerate(blocks):
        exec(compile(block, "docs/researchers.md", "exec"), names)
        if number == 1:
            assert names["actions"].shape == (4, 2)
            assert np.array_equal(names["actions"], names["policy"].act(names["observation"]))
    assert capsys.readouterr().out.splitlines()[0].startswith("[")

    algorithm = next(block for block in blocks if "SmallPpo" in block)
    assert len(algorithm.splitlines()) < 100
    check_that_it_is_resumed_to_the_same_bits(names, run_folder)
    card = robosim.load_policy(run_folder / "shared").card
    assert (card.technique.name, card.training.steps, card.network.networks) == ("shared dqn", 240, 1)
    commands = re.findall(r"^    robosim ((?:evaluate|play) runs/shared.*)$", page, flags=re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        assert main([*command.split(), "--steps", "20"]) == 0
    assert (run_folder.parent / "shared.rrd").stat().st_size > 10_000


def check_that_it_is_resumed_to_the_same_bits(names, runs):
    """The algorithm of the page keeps the promise that the page makes for it."""
    config = names["run_config"]("small-ppo", steps=640, num_envs=2, rollout=7, evaluation_episodes=0)

    def stop(row):
        raise KeyboardInterrupt

    names["train"](config, runs / "whole", lambda row: None)
    with pytest.raises(KeyboardInterrupt):
        names["train"](config, runs / "parts", stop)
    resume(runs / "parts", lambda row: None)
    whole, parts = (robosim.load_policy(runs / name).weights() for name in ("whole", "parts"))
    for name, array in whole.items():
        np.testing.assert_array_equal(array, parts[name])


def test_the_page_shows_the_example_that_saves_a_team(examples, page) -> None:
    assert f"```python\n{(examples / 'saving.py').read_text(encoding='utf-8')}```" in page
