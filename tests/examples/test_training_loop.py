import subprocess
import sys

import pytest

import robosim
from robosim.control.evaluate import evaluate

NEAR = """
name = "near"
description = "Home and source side by side."
cell_size = 0.15
map = '''
#########
#HHH.SSS#
#HHH.SSS#
#HHH.SSS#
#########
'''

[pellets]
count = 8
"""


@pytest.mark.slow
def test_two_robots_learn_to_deliver(examples, tmp_path) -> None:
    from training_loop import learn

    arena = tmp_path / "near.toml"
    arena.write_text(NEAR)
    env = robosim.vector_env(arena, robots=2, num_envs=8, reward="local", episode_steps=50)
    learner = learn(env, steps=2400, seed=0)
    test = robosim.vector_env(arena, robots=2, num_envs=4, seed=5, episode_steps=200)
    observation = test.reset()
    for _ in range(200):
        outcome = test.step(learner.act(observation, epsilon=0.02))
        observation = outcome.observation
    by_chance = sum(evaluate(robosim.make_controller("random"), test, episodes=4, seed=5).totals)
    # Six seeds gave 26 to 44; chance gives none.
    assert outcome.final_delivered.sum() >= by_chance + 12


@pytest.mark.slow
def test_it_runs_as_a_script_and_says_what_it_delivers(examples) -> None:
    script = [sys.executable, examples / "training_loop.py", "--steps", "160", "--test-steps", "10"]
    run = subprocess.run(script, capture_output=True, text=True, timeout=120, check=True)
    assert [line.split(":")[0] for line in run.stdout.splitlines()] == [f"episode {i}" for i in range(6)]


def test_it_is_as_short_as_the_page_says(examples) -> None:
    lines = len((examples / "training_loop.py").read_text().splitlines())
    assert lines < 60
    assert f"in {lines} lines" in (examples.parent / "docs" / "researchers.md").read_text()
