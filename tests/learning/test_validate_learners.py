"""tools/validate_learners.py: simple_spread in batches, robosim's algorithms in it, and the report."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(scope="module")
def tool():
    sys.path.insert(0, str(TOOLS))
    spec = importlib.util.spec_from_file_location("validate_learners", TOOLS / "validate_learners.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(str(TOOLS))


@pytest.fixture(scope="module")
def spread(tool):
    from validation import spread

    return spread


def plain_step(position, velocity, landmarks, actions):
    """Simple_spread of one environment, agent by agent; returns rewards and observations."""
    push = {0: (0, 0), 1: (-5, 0), 2: (5, 0), 3: (0, -5), 4: (0, 5)}
    forces = [np.array(push[action], float) for action in actions]
    for a in range(3):
        for b in range(a + 1, 3):
            apart = position[a] - position[b]
            distance = np.hypot(*apart)
            force = 100.0 * apart / distance * np.logaddexp(0, -(distance - 0.3) / 1e-3) * 1e-3
            forces[a], forces[b] = forces[a] + force, forces[b] - force
    for agent in range(3):
        position[agent] += 0.1 * velocity[agent]
        velocity[agent] = 0.75 * velocity[agent] + 0.1 * forces[agent]
    far = sum(min(np.hypot(*(place - mark)) for place in position) for mark in landmarks)
    rewards, seen = [], []
    for agent in range(3):
        others = [other for other in range(3) if other != agent]
        hits = sum(np.hypot(*(position[agent] - position[other])) < 0.3 for other in others)
        rewards.append(-0.5 * far - 0.5 * hits)
        parts = [velocity[agent], position[agent], *(mark - position[agent] for mark in landmarks)]
        parts += [position[other] - position[agent] for other in others]
        seen.append(np.concatenate([*parts, np.zeros(4)]))
    return rewards, seen


def test_batches_are_simple_spread_written_plainly(spread):
    env, rng, hits = spread.Spread(4, seed=0), np.random.default_rng(1), 0
    env.reset()
    env._position *= 0.3  # near each other, so that some touch
    worlds = [(env._position[i].copy(), np.zeros((3, 2)), env._landmark[i].copy()) for i in range(4)]
    for decision in range(spread.EPISODE):
        actions = rng.integers(5, size=(4, 3))
        step = env.step(actions)
        for i, world in enumerate(worlds):
            rewards, seen = plain_step(*world, actions[i])
            np.testing.assert_allclose(step.reward[i], rewards, rtol=1e-5)
            np.testing.assert_allclose(step.final_observation[i], seen, rtol=1e-4, atol=1e-5)
        hits += len(np.unique(step.reward.round(5))) > 4
        assert step.truncated == (decision == spread.EPISODE - 1)
    assert hits
    assert len(env.returns) == 1
    assert not np.array_equal(step.observation, step.final_observation)


@pytest.mark.skipif(importlib.util.find_spec("mpe2") is None, reason="mpe2 is not installed")
def test_batches_are_those_of_mpe2(spread):
    assert spread.difference_to_mpe2(episodes=5, seed=3) < 1e-6


@pytest.mark.parametrize("method", ["dqn", "ia2c", "maddpg"])
def test_algorithms_act_in_it(spread, method):
    from validation import ours

    act, returns, settings = ours.learn(method, seed=0, decisions=400)
    assert len(returns) == 2
    assert settings["name"] == method
    final = spread.evaluate(act, 6, 100)
    assert final == spread.evaluate(act, 6, 100)
    assert len(set(final)) == 6
    assert max(final) < 0.0


def test_every_algorithm_is_compared(tool):
    from validation import ours

    from robosim.learning.algorithms.registry import algorithm_names, find_algorithm

    assert {name for name, _, _ in ours.METHODS.values()} == set(algorithm_names())
    for name, _, options in ours.METHODS.values():
        find_algorithm(name)(**options)


def test_the_report_says_what_ran_and_what_did_not(tool, tmp_path, monkeypatch, capsys):
    results, png = tmp_path / "results.jsonl", tmp_path / "figures" / "curves.png"
    curve = tool._curve([-30.0 + i for i in range(40)], 1000)
    assert curve[0] == (38, -29.5)
    assert curve[-1] == (988, 8.5)
    assert len(curve) == 20
    lines = [
        {
            "library": library,
            "method": method,
            "seed": seed,
            "decisions": 1000,
            "curve": curve,
            "final_mean": mean,
        }
        for library, method, seed, mean in (
            ("robosim", "dqn", 0, -20.0),
            ("robosim", "dqn", 1, -22.0),
            ("epymarl", "maddpg", 0, -21.0),
        )
    ]
    results.write_text("".join(json.dumps(line) + "\n" for line in lines))
    monkeypatch.setattr(sys, "argv", ["validate", "--results", str(results), "report", "--png", str(png)])
    tool.main()
    assert capsys.readouterr().out.splitlines() == [
        "| method | robosim | stable-baselines3 | epymarl |",
        "|---|---|---|---|",
        "| dqn | -21.0 (1.4), 2 | not run | not run |",
        "| maddpg | not run | not run | -21.0, 1 |",
    ]
    assert png.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["robosim", "dqn"], "robosim needs the package no_such_package, which is not installed here."),
        (
            ["epymarl", "qmix", "--epymarl", "nowhere"],
            "--epymarl is nowhere, but must be a checkout of github.com/uoe-agents/epymarl.",
        ),
        (
            ["stable-baselines3", "qmix"],
            "stable-baselines3 has no method qmix here: it has dqn, ia2c, ippo.",
        ),
    ],
)
def test_what_is_missing_is_one_sentence(tool, monkeypatch, arguments, sentence):
    monkeypatch.setattr(sys, "argv", ["validate", "run", *arguments])
    for name, library in tool.LIBRARIES.items():
        packages = ("no_such_package",) if name == "robosim" else ("json",)
        monkeypatch.setitem(tool.LIBRARIES, name, library._replace(packages=packages))
    monkeypatch.setattr(tool, "REQUIRED", ())
    with pytest.raises(SystemExit) as caught:
        tool.main()
    assert caught.value.code == sentence


def test_a_report_of_nothing_is_one_sentence(tool, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["validate", "--results", str(tmp_path / "none.jsonl"), "report"])
    with pytest.raises(SystemExit) as caught:
        tool.main()
    assert caught.value.code == f"{tmp_path}/none.jsonl: there are no results yet; `run` makes them."
