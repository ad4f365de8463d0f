"""Every policy that ships is whole, fits its arena, and does what its card claims.

The rule: a team drives `ENVS` environments to decision `LAST`, and what it delivers from decision `FIRST`
on is compared with the card. With f the window's share of an episode, m and s the card's mean and standard
deviation over n episodes, an environment should deliver m f in the window. Were deliveries of different times
independent, the mean over the environments would differ from that with the standard deviation
s sqrt(f / ENVS + f^2 / n), the second term for the card's own error. Four of those are allowed, and one trip
of each robot, since a window cuts trips at both ends, and at the same place for robots that start together.
Each robot has to keep this rule for itself, and the team as a whole. Below a quarter of the claim a team
fails however wide its spread, so one that stands still always does.
"""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

import robosim
from robosim.arena import arena_names, load_arena
from robosim.cli.card_facts import facts_of
from robosim.cli.main import main
from robosim.cli.model_card import MOST_CLIP_BYTES, readme_text
from robosim.control.card import Evaluation
from robosim.control.controller import SCRIPTED
from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import (
    CARD_FILE,
    CLIP_FILE,
    README_FILE,
    WEIGHTS_FILE,
    Policy,
    find_policy,
    folder_size,
    policy_names,
)

ROOT = Path(__file__).parent.parent.parent
MOST_BYTES = 1_500_000
ENVS, FIRST, LAST = 4, 200, 1000
SEED = 2024

shipped = pytest.mark.parametrize("name", policy_names())


def delivered_in_window(policy: Policy, name: str) -> np.ndarray:
    """Return the pellets that each robot delivers in the window, [robots], mean over environments."""
    controller = LearnedController(policy, name)
    env = environment_for(controller, num_envs=ENVS, seed=SEED)
    observation = env.reset()
    controller.reset(env)
    for step in range(LAST):
        if step == FIRST:
            before = env.delivered.copy()
        observation = env.step(controller.act(env, observation)).observation
    return (env.delivered - before).mean(axis=0)


def disagreements(delivered: np.ndarray, claim: Evaluation) -> list[str]:
    """Return what of `delivered` [robots] goes against a card's claim, by the rule above."""
    episodes = np.array(claim.delivered, dtype=float)
    f = (LAST - FIRST) / claim.episode_steps
    error = (f / ENVS + f**2 / len(episodes)) ** 0.5
    found = []
    for robot, count in enumerate(delivered):
        claimed = episodes[:, robot]
        if abs(count - f * claimed.mean()) > 4 * error * claimed.std(ddof=1) + 1:
            found.append(f"robot {robot}: {count:.1f} instead of {f * claimed.mean():.1f}")
    totals = episodes.sum(axis=1)
    expected, tolerance = f * totals.mean(), 4 * error * totals.std(ddof=1) + len(delivered)
    if not max(expected / 4, expected - tolerance) <= delivered.sum() <= expected + tolerance:
        found.append(f"team: {delivered.sum():.1f} instead of {expected:.1f} +- {tolerance:.1f}")
    return found


def shuffled(name: str) -> Policy:
    """Return the policy with the numbers of each layer in another order, for each robot by itself."""
    rng = np.random.default_rng(0)
    weights = safetensors.numpy.load_file(find_policy(name) / WEIGHTS_FILE)
    mixed = {
        key: rng.permuted(array.reshape(len(array), -1), axis=1).reshape(array.shape)
        for key, array in weights.items()
    }
    return Policy(mixed, robosim.load_policy(name).card)


def test_policies_ship_and_nothing_lies_beside_them():
    assert policy_names()
    beside = [path.name for path in find_policy(policy_names()[0]).parent.iterdir()]
    assert sorted(beside) == sorted(policy_names())


@shipped
def test_folder_is_small_and_holds_a_policy_and_its_page_alone(name):
    folder = find_policy(name)
    assert {path.name for path in folder.iterdir()} == {CARD_FILE, WEIGHTS_FILE, README_FILE, CLIP_FILE}
    assert folder_size(folder) <= MOST_BYTES
    assert (folder / CLIP_FILE).stat().st_size <= MOST_CLIP_BYTES


@shipped
def test_page_is_what_the_command_makes_of_the_card(name):
    folder, card = find_policy(name), robosim.load_policy(name).card
    text = (folder / README_FILE).read_text(encoding="utf-8")
    assert text == readme_text(name, card, facts_of(name, card, folder), with_clip=True)
    assert f"{card.evaluation.mean:.1f} +- {card.evaluation.std:.1f} per episode" in text


@shipped
def test_card_is_complete(name):
    card = robosim.load_policy(name).card
    assert "notes" in json.loads((find_policy(name) / CARD_FILE).read_text(encoding="utf-8"))
    words = shlex.split(card.training.command)
    assert words[:2] in (["robosim", "train"], ["python", "tools/average_policies.py"])
    assert not any(word.startswith("/") or "=/" in word for word in words)
    assert card.training.steps > 0
    assert card.training.wall_time > 0
    assert {"robosim", "numpy", "torch"} <= card.training.versions.keys()
    claim, reference = card.evaluation, card.reference
    assert claim is not None
    assert reference is not None
    assert (claim.controller, reference.controller) == (name, "lanes")
    assert claim.seed != card.training.seed
    assert claim.episodes >= 12
    for field in ("arena", "robots", "episodes", "episode_steps", "seed"):
        assert getattr(claim, field) == getattr(reference, field)
    assert (claim.arena, claim.robots) == (card.arena.name, card.robots)
    assert claim.episode_steps == load_arena(card.arena.name).timing.episode_steps


@shipped
def test_loads_by_name_from_anywhere_and_fits_its_arena(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert name not in SCRIPTED
    controller = robosim.make_controller(name)
    assert isinstance(controller, LearnedController)
    card = controller.policy.card
    assert card.arena.name in arena_names()
    assert card.env.arena == load_arena(card.arena.name).text
    controller.reset(environment_for(controller))


QUICK = (
    "any", "paper-1", "paper-4", "paper-2-smadrl", "paper-4-wheels", "relay-4", "robotarium-4",
)  # fmt: skip
"""One of each kind; the others differ from these in size or settings, and run with what takes longer."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in policy_names()]
)
def test_delivers_what_its_card_claims(name):
    policy = robosim.load_policy(name)
    assert disagreements(delivered_in_window(policy, name), policy.card.evaluation) == []


def test_the_rule_catches_shuffled_weights():
    name = policy_names()[0]
    policy = shuffled(name)
    assert disagreements(delivered_in_window(policy, name), policy.card.evaluation)


def claim_of(*episodes: tuple[int, ...]) -> Evaluation:
    return Evaluation(
        controller="x",
        arena="paper",
        robots=len(episodes[0]),
        episode_steps=5000,
        seed=0,
        delivered=episodes,
        collisions=(0,) * len(episodes),
    )


def test_the_rule():
    steady = claim_of(*[(50, 50), (51, 49), (49, 51)] * 4)
    assert disagreements(np.array([8.0, 8.0]), steady) == []
    assert disagreements(np.array([8.9, 7.2]), steady) == []
    assert disagreements(np.array([8.0, 0.0]), steady) == [
        "robot 1: 0.0 instead of 8.0",
        "team: 8.0 instead of 16.0 +- 2.0",
    ]
    assert disagreements(np.array([12.0, 4.0]), steady) == [
        "robot 0: 12.0 instead of 8.0",
        "robot 1: 4.0 instead of 8.0",
    ]
    wide = claim_of(*[(5, 5), (95, 95)] * 6)
    assert disagreements(np.array([2.1, 2.1]), wide) == []
    assert disagreements(np.array([1.9, 1.9]), wide) == ["team: 3.8 instead of 16.0 +- 79.2"]


def test_the_page_holds_the_table_of_the_command(capsys):
    assert policy_names()
    assert main(["policy", "list", "--markdown"]) == 0
    assert capsys.readouterr().out in (ROOT / "docs" / "policies.md").read_text(encoding="utf-8")
