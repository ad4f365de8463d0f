"""Lists as JSON: the facts of the tables, under the keys that docs/public.md states."""

import json
import re
from pathlib import Path

import pytest

from robosim.arena import arena_names, load_arena
from robosim.cli.main import main
from robosim.control.policy import find_policy, load_policy, policy_names
from robosim.envs.profile import load_profile, profile_names
from robosim.experiments.sweep import read_sweep
from robosim.learning.algorithms.registry import algorithm_names
from robosim.learning.config import run_config
from robosim.learning.technique import TECHNIQUES

PUBLIC = (Path(__file__).parents[2] / "docs" / "public.md").read_text(encoding="utf-8")


def keys_of(command: str) -> list[str]:
    """Return the keys that the page states for a list; what stands in brackets explains them."""
    (row,) = re.findall(rf"^\| `robosim {command} --json` \| (.*) \|$", PUBLIC, re.MULTILINE)
    return re.findall(r"`(\w+)`", re.sub(r"\([^)]*\)", "", row))


def listed(command: str, capsys: pytest.CaptureFixture[str]) -> list[dict]:
    assert main([*command.split(), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert all(list(row) == keys_of(command) for row in rows)
    return rows


def table(command: str, capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    """Return the words of each row of the list as a table."""
    assert main(command.split()) == 0
    return [line.split() for line in capsys.readouterr().out.splitlines()[1:]]


@pytest.mark.parametrize("command", ["arena list", "policy list", "technique list", "profile list"])
def test_the_json_has_the_rows_of_the_table(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    rows = listed(command, capsys)
    assert [row["name"] for row in rows] == [words[0] for words in table(command, capsys)]


def test_arenas(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row["name"]: row for row in listed("arena list", capsys)}
    assert list(rows) == arena_names()
    arena = load_arena("s-bend")
    assert rows["s-bend"] == {
        "name": "s-bend",
        "size": list(arena.size),
        "robots": arena.capacity,
        "tunnel_cells": arena.tunnel_length,
        "description": arena.description,
    }


def test_policies(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row["name"]: row for row in listed("policy list", capsys)}
    assert list(rows) == policy_names()
    card = load_policy("s-bend-4").card
    row = rows["s-bend-4"]
    assert (row["arena"], row["robots"], row["technique"]) == ("s-bend", 4, card.technique.name)
    assert row["pellets"] == card.evaluation.mean
    assert row["pellets_std"] == card.evaluation.std
    assert row["share_of_reference"] == card.evaluation.mean / card.reference.mean
    folder = find_policy("s-bend-4")
    assert row["bytes"] == sum((folder / name).stat().st_size for name in ("card.json", "policy.safetensors"))


def test_techniques(capsys: pytest.CaptureFixture[str]) -> None:
    rows = listed("technique list", capsys)
    assert {row["name"] for row in rows} == set(TECHNIQUES)
    assert {row["algorithm"] for row in rows} == set(algorithm_names())
    for row in rows:
        config = run_config(row["name"])
        assert config == run_config(row["name"], **row["options"])
        assert config.algorithm.name == row["algorithm"]
        assert row["description"].endswith(".")


def test_a_technique_is_shown_with_what_it_sets(capsys: pytest.CaptureFixture[str]) -> None:
    assert table("technique show ps-ippo", capsys) == [
        ["algorithm", "ppo"],
        ["reward", '"local"'],
        ["signed_distance", "true"],
        ["stigmergy", "true"],
        ["idle_cost", "true"],
        ["parameters", '"shared"'],
        ["mask", "true"],
        ["num_envs", "32"],
    ]
    assert main(["technique", "show", "ps-ipo"]) == 2
    assert capsys.readouterr().err.startswith('robosim: unknown technique "ps-ipo": did you mean ps-ippo')


def test_a_profile_is_shown_with_what_it_changes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert {row["name"] for row in listed("profile list", capsys)} == set(profile_names())
    shown = {words[0]: " ".join(words[1:]) for words in table("profile show robotarium", capsys)}
    profile = load_profile("robotarium")
    assert shown["motion.wheel_gain"] == str(list(profile.motion.wheel_gain))
    assert shown["sensing.outliers"] == str(profile.sensing.outliers)
    own = tmp_path / "own.toml"
    own.write_text('name = "a\\u001b[31m"\ndescription = "b\\u0007"\n[sensing]\ndropout = 0.5\n')
    assert main(["profile", "show", str(own)]) == 0
    assert capsys.readouterr().out.splitlines() == ["a?[31m: b?", f"  {'sensing.dropout':<28}  0.5"]


def test_runs_of_a_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.toml"
    path.write_text(
        '[options]\nworld = "grid"\n[vary]\ntechnique = ["lanes", "active"]\nrobots = [2, 3]\n'
        '[[where]]\nmatch = { technique = "active", robots = 3 }\nskip = "too many"\n'
        "[evaluation]\nepisodes = 1\nsteps = 20\n"
    )
    assert main(["sweep", str(path), "--dry-run", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    keys = keys_of("sweep FILE --dry-run")
    assert all(list(row) == keys for row in rows)
    assert [(row["values"], row["state"], row["why"]) for row in rows] == [
        ({"technique": "lanes", "robots": 2}, "to do", None),
        ({"technique": "lanes", "robots": 3}, "to do", None),
        ({"technique": "active", "robots": 2}, "to do", None),
        ({"technique": "active", "robots": 3}, "skipped", "too many"),
    ]
    assert rows[1]["run"] == "technique=lanes robots=3"
    jobs = read_sweep(path).jobs
    assert [row["key"] for row in rows] == [*(job.key for job in jobs), None]
    assert main(["sweep", str(path), "--json"]) == 2
    assert capsys.readouterr().err == "robosim: --json prints the list of runs: it needs --dry-run.\n"


def test_one_list_is_printed_one_way(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policy", "list", "--json", "--markdown"]) == 2
    assert capsys.readouterr().err == (
        "robosim: --markdown and --json are two ways to print one list: give one of them.\n"
    )
