import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import robosim.control.policy as policy_module
from robosim.arena import load_arena, parse_arena
from robosim.cli.main import main
from robosim.control.card import (
    Evaluation,
    PolicyCard,
    StageCard,
    TrainingCard,
    arena_card,
    card_for,
    card_text,
)
from robosim.control.network import NetworkSpec
from robosim.control.policy import find_policy, load_policy, read_policy, save_policy
from robosim.envs.vector import VectorEnv


def make_evaluation(controller: str, *totals: int, steps: int = 5000) -> Evaluation:
    return Evaluation(
        controller=controller,
        arena="paper",
        robots=2,
        episode_steps=steps,
        seed=7,
        delivered=tuple((total // 2, total - total // 2) for total in totals),
        collisions=tuple(range(len(totals))),
    )


def make_policy(folder: Path, **changes: object) -> PolicyCard:
    """Write a policy of two robots for the arena `paper`, with weights of 0, and return its card."""
    env = VectorEnv("paper", robots=2, reward="global")
    spec = NetworkSpec(inputs=env.layout.size, hidden=(8,), of_robot=(0, 1))
    weights = {name: np.zeros(shape, np.float32) for name, shape in spec.shapes.items()}
    training = TrainingCard(
        command="robosim train --robots 2 --technique smadrl --out runs/paper-2",
        seed=3,
        steps=30000,
        wall_time=61.4,
        versions={"numpy": "2.4", "torch": "2.13"},
        stages=(
            StageCard(name="first team", robots=1, learning=1, steps=10000, ended="steady"),
            StageCard(name="newcomer 2", robots=2, learning=1, steps=20000, ended="budget"),
        ),
    )
    fields: dict[str, object] = {
        "evaluation": make_evaluation("paper-2", 80, 90, 85),
        "reference": make_evaluation("lanes", 88, 90, 89),
        "notes": "Stands still once in a while.",
    }
    card = card_for(env, spec, weights, "smadrl", training, {"algorithm": "double DQN"})
    card = card.changed(**(fields | changes))
    save_policy(folder, weights, card)
    return card


@pytest.fixture
def ships(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of policies in the place of those that ship."""
    folder = tmp_path / "ships"
    folder.mkdir()
    monkeypatch.setattr(policy_module, "shipped_folder", lambda kind: folder)
    return folder


def test_list_shows_what_each_delivers(ships: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_policy(ships / "paper-2")
    make_policy(ships / "paper-2-short", evaluation=make_evaluation("x", 4, 4, steps=100), reference=None)
    make_policy(ships / "paper-2-unknown", evaluation=None)
    assert main(["policy", "list"]) == 0
    assert [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()] == [
        "name arena robots technique pellets in 5000 decisions of lanes size",
        "paper-2 paper 2 smadrl 85.0 +- 5.0 96 % 0.02 MB",
        "paper-2-short paper 2 smadrl 4.0 +- 0.0 in 100 0.02 MB",
        "paper-2-unknown paper 2 smadrl not evaluated 0.02 MB",
    ]


def test_list_prints_markdown(ships: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_policy(ships / "paper-2")
    assert main(["policy", "list", "--markdown"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "| name | arena | robots | technique | pellets in 5000 decisions | of lanes | size |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| paper-2 | paper | 2 | smadrl | 85.0 +- 5.0 | 96 % | 0.02 MB |",
    ]


def test_list_of_nothing_is_a_sentence(ships: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policy", "list"]) == 0
    assert capsys.readouterr().out == "No policies ship with this robosim.\n"


def test_show_tells_all_that_the_card_holds(ships: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_policy(ships / "paper-2")
    assert main(["policy", "show", "paper-2"]) == 0
    shown = capsys.readouterr().out
    for line in (
        "technique     smadrl: algorithm double DQN",
        "reward        pickups and deliveries pay the whole team",
        "command       robosim train --robots 2 --technique smadrl --out runs/paper-2",
        "seed          3",
        "learned for   30000 joint decisions, 61 s",
        "stages        first team: 1 of 1 robots learned for 10000 joint decisions, until steady",
        "              newcomer 2: 1 of 2 robots learned for 20000 joint decisions, the whole budget",
        "versions      numpy 2.4, torch 2.13",
        "world         physics",
        "observation   143 numbers, expanded, with pheromones",
        "actions       5, cardinal, every 0.3 s",
        "network       143 x 8 x 5, one for each robot, stored as float32",
        "              action values from the robot's own observation, relu",
        "evaluation    paper-2 in paper: 3 episodes of 5000 decisions, seed 7",
        "  pellets     85.0 +- 5.0 per episode",
        "  episodes    80  90  85",
        "  robots      42.3  42.7",
        "  collisions  1.0 per episode",
        "reference     lanes in paper: 3 episodes of 5000 decisions, seed 7",
        "share         95.5 % of the reference",
        "fails at      Stands still once in a while.",
        "see it        robosim play paper-2 --save paper-2.rrd",
        "measure it    robosim evaluate paper-2 --episodes 3 --seed 7",
    ):
        assert line in shown.splitlines()


def test_show_json_is_the_card(ships: Path, capsys: pytest.CaptureFixture[str]) -> None:
    card = make_policy(ships / "paper-2")
    assert main(["policy", "show", "paper-2", "--json"]) == 0
    out = capsys.readouterr().out
    weights = (ships / "paper-2" / "policy.safetensors").read_bytes()
    assert out == card_text(card.changed(weights_sha256=hashlib.sha256(weights).hexdigest()))
    assert json.loads(out)["notes"] == card.notes


def test_show_of_a_run_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "my run"
    make_policy(run / "policy", evaluation=make_evaluation("x", 3, 5, steps=100), reference=None, notes="")
    assert main(["policy", "show", str(run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "fails at      not noted" in lines
    assert f"see it        robosim play '{run}' --save 'my run.rrd'" in lines
    assert f"measure it    robosim evaluate '{run}' --episodes 2 --seed 7 --steps 100" in lines


def test_a_strangers_card_cannot_steer_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_policy(tmp_path / "p", notes="\x1b[2Jfine\r\n")
    assert main(["policy", "show", str(tmp_path / "p")]) == 0
    assert "fails at      ?[2Jfine??\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("papr-2", "no policy is named 'papr-2', and there is no such folder: did you mean paper-2?"),
        ("lanes", "'lanes' is a scripted controller: it has no card."),
    ],
)
def test_wrong_input_exits_with_2_and_one_sentence(
    ships: Path, name: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    make_policy(ships / "paper-2")
    assert main(["policy", "show", name]) == 2
    assert capsys.readouterr() == ("", f"robosim: {sentence}\n")


def test_evaluate_takes_a_name(
    ships: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make_policy(ships / "paper-2")
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", "paper-2", "--episodes", "1", "--steps", "5"]) == 0
    assert capsys.readouterr().out.startswith("paper-2 in paper, 2 robots, 1 episode of 5 decisions:")
    assert main(["evaluate", "papr-2"]) == 2
    assert capsys.readouterr().err.endswith("did you mean paper-2?\n")


def test_a_policy_of_an_own_arena_takes_it_along_and_its_report_can_be_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arena = load_arena("paper")
    text = arena.text.replace('name = "paper"', 'name = "my cave"')
    about = arena_card(parse_arena(text, "my cave"))
    env = VectorEnv("paper", robots=2).config.changed(arena=text)
    make_policy(tmp_path / "p", env=env, arena=about, evaluation=None, reference=None)
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", "p", "--episodes", "1", "--steps", "5", "--report", "out"]) == 0
    assert capsys.readouterr().out.startswith("p in my cave, 2 robots, 1 episode of 5 decisions:")
    command = json.loads((tmp_path / "out" / "metrics.json").read_text())["command"]
    assert command == "robosim evaluate p --robots 2 --episodes 1 --steps 5 --seed 0 --report FOLDER"
    assert main(command.replace("FOLDER", "again").split()[1:]) == 0


def test_the_world_must_be_one_that_there_is(ships: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_policy(ships / "paper-2")
    command = ["evaluate", "paper-2", "--episodes", "1", "--steps", "5"]
    assert main([*command, "--world", "physics"]) == 0
    assert main([*command, "--world", "water"]) == 2


def test_help_and_piped_output_are_plain() -> None:
    for arguments in (["policy", "--help"], ["policy", "list"]):
        command = [sys.executable, "-m", "robosim", *arguments]
        result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert (result.returncode, result.stderr) == (0, "")
        assert "\x1b" not in result.stdout


def test_show_rounds_the_period_of_the_grid(ships: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grid = VectorEnv("paper", robots=2, world="grid").arena
    make_policy(ships / "paper-2", arena=arena_card(grid))
    assert main(["policy", "show", "paper-2"]) == 0
    assert "actions       5, cardinal, every 0.75 s" in capsys.readouterr().out.splitlines()


def test_a_page_is_written_beside_a_policy_and_goes_with_it_when_it_is_replaced(tmp_path, capsys):
    folder = tmp_path / "mine"
    shutil.copytree(find_policy("paper-1"), folder, ignore=shutil.ignore_patterns("README.md", "clip.webp"))
    assert main(["policy", "readme", str(folder), "--no-clip"]) == 0
    assert capsys.readouterr().out == f"written: {folder}/README.md\n"
    page = (folder / "README.md").read_text()
    assert "# mine\n\nA team of 1 robot that carries pellets in arena `paper`" in page
    assert "clip.webp" not in page
    assert main(["policy", "readme", str(folder)]) == 0
    assert "(clip.webp)" in (folder / "README.md").read_text()
    with Image.open(folder / "clip.webp") as clip:
        assert clip.n_frames == 41
    policy = read_policy(folder)
    save_policy(folder, policy.weights(), policy.card)
    assert sorted(path.name for path in folder.iterdir()) == ["card.json", "policy.safetensors"]


def test_texts_of_a_card_steer_no_page(tmp_path):
    folder = tmp_path / "mine"
    policy = load_policy("paper-1")
    save_policy(folder, policy.weights(), policy.card.changed(notes="a|b <script>\x1b[31m *x* [y](z)"))
    assert main(["policy", "readme", str(folder), "--no-clip"]) == 0
    page = (folder / "README.md").read_text()
    assert "| fails at | a\\|b \\<script\\>?\\[31m \\*x\\* \\[y\\](z) |" in page


def test_a_run_keeps_its_policy_folder_to_itself(tmp_path, capsys):
    shutil.copytree(find_policy("paper-1"), tmp_path / "run" / "policy")
    assert main(["policy", "readme", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err == (
        f"robosim: {tmp_path}/run/policy: a run keeps this folder as it wrote it: "
        "copy it, and give the copy.\n"
    )


def test_the_page_of_a_team_that_ships_stays_as_it_is(capsys):
    page = find_policy("paper-1") / "README.md"
    before = page.read_bytes(), page.stat().st_mtime_ns
    assert main(["policy", "readme", "paper-1", "--no-clip"]) == 2
    assert capsys.readouterr().err == f"robosim: 'paper-1' ships with its page: {page}.\n"
    assert (page.read_bytes(), page.stat().st_mtime_ns) == before
