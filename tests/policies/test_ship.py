"""tools/ship_policy.py: from a run folder to a policy that ships."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from robosim.control.card import TrainingCard, card_for
from robosim.control.network import NetworkSpec
from robosim.control.policy import load_policy, save_policy
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError

TOOL = Path(__file__).parent.parent.parent / "tools" / "ship_policy.py"
spec = importlib.util.spec_from_file_location("ship_policy", TOOL)
tool = importlib.util.module_from_spec(spec)
spec.loader.exec_module(tool)


def make_run(folder, robots=2, hidden=(8,), command="robosim train --seed 1 --out /somewhere/x", alike=()):
    """Write a run folder as training leaves it, with random weights; `alike` robots run that of robot 0."""
    env = VectorEnv("paper", robots=robots)
    spec = NetworkSpec(inputs=env.layout.size, hidden=hidden, of_robot=tuple(range(robots)))
    rng = np.random.default_rng(0)
    weights = {name: rng.normal(size=shape).astype(np.float32) for name, shape in spec.shapes.items()}
    for array in weights.values():
        array[list(alike)] = array[0]
    training = TrainingCard(command=command, seed=1, steps=10, wall_time=1.5, versions={"numpy": "2"})
    save_policy(folder / "policy", weights, card_for(env, spec, weights, "iql+s", training))
    return folder


def ship(run, name, into, **options):
    return tool.ship(run, name, into, **({"episodes": 2, "episode_steps": 20} | options))


def test_ships_whole_with_evaluation_reference_and_notes(tmp_path, capsys):
    run = make_run(tmp_path / "run")
    card = ship(run, "paper-2", tmp_path / "to", notes="Stands still.")
    shipped = load_policy(tmp_path / "to" / "paper-2")
    assert shipped.card == card
    assert [path.name for path in (tmp_path / "to").iterdir()] == ["paper-2"]
    page = (tmp_path / "to" / "paper-2" / "README.md").read_text()
    assert "| command | robosim train --seed 1 --out runs/paper-2 |" in page
    assert "| fails at | Stands still. |" in page
    assert card.notes == "Stands still."
    assert card.network.precision == "float32"
    assert card.training.command == "robosim train --seed 1 --out runs/paper-2"
    for evaluation, controller in ((card.evaluation, "paper-2"), (card.reference, "lanes")):
        assert (evaluation.controller, evaluation.arena, evaluation.robots) == (controller, "paper", 2)
        assert (evaluation.seed, evaluation.episodes, evaluation.episode_steps) == (7, 2, 20)
    observation = np.random.default_rng(1).normal(size=(20, 2, len(card.observation)))
    assert (shipped.values(observation) == load_policy(run).values(observation)).all()


def test_one_network_for_all_ships_as_a_team_of_another_size(tmp_path):
    run = make_run(tmp_path / "run", robots=2, alike=[1])
    # Stored once, it is one that all robots run.
    ship(run, "p", tmp_path / "to")
    card = ship(tmp_path / "to" / "p", "q", tmp_path / "to", robots=3)
    assert (card.robots, card.network.of_robot, card.evaluation.robots) == (3, (0, 0, 0), 3)
    with pytest.raises(InputError) as caught:
        ship(make_run(tmp_path / "own"), "r", tmp_path / "to", robots=3)
    assert str(caught.value) == "--robots is 3: it needs a policy of which all robots run one network."


@pytest.mark.parametrize(("half", "most"), [(True, 1_500_000), (False, 20_000)])
def test_rounds_when_asked_or_when_too_large(tmp_path, monkeypatch, half, most):
    run = make_run(tmp_path / "run", robots=4)
    monkeypatch.setattr(tool, "MOST_BYTES", most)
    card = ship(run, "p", tmp_path / "to", half=half)
    assert card.network.precision == "float16"
    before = safetensors.numpy.load_file(run / "policy" / "policy.safetensors")
    stored = safetensors.numpy.load_file(tmp_path / "to" / "p" / "policy.safetensors")
    for key, array in before.items():
        assert (stored[key] == array.astype(np.float16)).all()
        assert stored[key].dtype == np.float16


def test_what_stays_too_large_is_refused_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(tool, "MOST_BYTES", 4_000)
    with pytest.raises(InputError, match="policy p would take .* it must take at most 4000; train narrower"):
        ship(make_run(tmp_path / "run"), "p", tmp_path / "to")
    assert not (tmp_path / "to").exists()


def test_equal_networks_are_stored_once(tmp_path):
    run = make_run(tmp_path / "run", robots=4, alike=(2, 3))
    card = ship(run, "p", tmp_path / "to")
    assert card.network.of_robot == (0, 1, 0, 0)
    stored = safetensors.numpy.load_file(tmp_path / "to" / "p" / "policy.safetensors")
    assert {len(array) for array in stored.values()} == {2}
    observation = np.random.default_rng(1).normal(size=(20, 4, len(card.observation)))
    shipped = load_policy(tmp_path / "to" / "p")
    assert (shipped.values(observation) == load_policy(run).values(observation)).all()
    again = ship(tmp_path / "to" / "p", "q", tmp_path / "to")
    assert again.network == card.network


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("Paper 2", {}, "NAME is 'Paper 2': it must be of small letters and digits, joined by hyphens."),
        ("../p", {}, "NAME is '../p': it must be of small letters and digits, joined by hyphens."),
        ("lanes", {}, "NAME is 'lanes': it must not be that of a scripted controller."),
        ("p", {"episodes": 0}, "--episodes is 0: it must be from 1 to 10000."),
        ("p", {"seed": -1}, "--seed is -1: it must not be negative."),
        ("p", {"seed": 1}, "--seed is 1, the seed of the training: it must be another."),
        ("p", {"notes": "x" * 2001}, "--notes has 2001 characters: it must have at most 2000."),
    ],
)
def test_wrong_requests_are_a_sentence(tmp_path, name, options, sentence):
    run = make_run(tmp_path / "run")
    with pytest.raises(InputError) as caught:
        ship(run, name, tmp_path / "to", **options)
    assert str(caught.value) == sentence
    assert not (tmp_path / "to").exists()


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("robosim train --out a --seed 1", "robosim train --seed 1 --out runs/p"),
        ("robosim train --out='/a b' --arena s-bend", "robosim train --arena s-bend --out runs/p"),
        ("robosim train", "robosim train --out runs/p"),
    ],
)
def test_command_is_one_that_others_can_run(command, shown):
    assert tool.shown_command(command, "p") == shown


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("", "is empty"),
        ("robosim train --arena '/a", "is not a whole command"),
        ("robosim train --arena /a/b.toml --out x", "holds '/a/b.toml'"),
        ("robosim train --start-from=/a", "holds '--start-from=/a'"),
    ],
)
def test_commands_that_nobody_else_can_run_are_refused(command, said):
    with pytest.raises(InputError, match=said):
        tool.shown_command(command, "p")


def test_from_the_command_line_wrong_input_exits_with_2(tmp_path):
    command = [sys.executable, TOOL, tmp_path / "no-run", "p", "--into", tmp_path / "to"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"robosim: no policy is named '{tmp_path / 'no-run'}'")
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
