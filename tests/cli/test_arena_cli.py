import subprocess
import sys
from pathlib import Path

import pytest

from robosim.arena import arena_names, load_arena
from robosim.arena.draw import drawing
from robosim.arena.random import random_arena
from robosim.cli.main import main


def run_arena(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "robosim", "arena", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, cwd=cwd)


def test_list_names_each_arena(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["arena", "list"]) == 0
    rows = capsys.readouterr().out.splitlines()[1:]
    assert [row.split()[0] for row in rows] == arena_names()


def test_list_draws_all(tmp_path: Path) -> None:
    assert main(["arena", "list", "--png", str(tmp_path / "all.png")]) == 0
    assert (tmp_path / "all.png").read_bytes().startswith(b"\x89PNG")


def test_show_from_any_directory_is_plain_when_piped(tmp_path: Path) -> None:
    result = run_arena("show", "paper", "--png", "paper.png", cwd=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert "\x1b" not in result.stdout
    assert all(row in result.stdout for row in drawing(load_arena("paper")))
    assert [path.name for path in tmp_path.iterdir()] == ["paper.png"]


@pytest.mark.parametrize("name", arena_names())
def test_show_tells_the_map_sizes_and_capacity(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["arena", "show", name]) == 0
    shown = capsys.readouterr().out
    arena = load_arena(name)
    assert arena.text.split('"""')[1].strip() in shown
    assert f"{arena.columns} x {arena.rows} cells of {arena.cell_size} m" in shown
    assert f"up to {arena.capacity}, starting from the home" in shown
    assert f"{arena.tunnel_length} cells" in shown


def test_show_names_what_is_random_and_given_poses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.toml"
    own.write_text(
        load_arena("paper").text
        + "\n[start]\nposes = [[0.5, 0.5, 0.0]]\n[randomisation]\ntraction = [0.8, 1]\n"
    )
    assert main(["arena", "show", str(own)]) == 0
    shown = capsys.readouterr().out
    assert "up to 1, starting from 1 given poses" in shown
    assert "traction times 0.8 to 1.0" in shown


def test_check_of_a_good_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = tmp_path / "own.toml"
    own.write_text(load_arena("single-lane").text)
    arena = load_arena(own)
    assert main(["arena", "check", str(own)]) == 0
    size = f"{arena.columns} x {arena.rows} cells"
    assert capsys.readouterr().out == f"{own}: ok: {size}, room for {arena.capacity} robots, 60 pellets\n"


def test_check_prints_every_mistake_and_exits_with_2(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(
        load_arena("paper").text.replace("count = 60", "count = 0\nlength = 3").replace("S#", "s#")
    )
    result = run_arena("check", str(own))
    lines = result.stderr.splitlines()
    assert (result.returncode, result.stdout) == (2, "")
    assert lines[0] == f"robosim: {own}: pellets.count is 0, but must be a whole number from 1 to 2000."
    assert lines[1].startswith(f"robosim: {own}: pellets.length is not a key of an arena file: ")
    assert len(lines) == 2 + 6
    assert all(line.startswith(f"robosim: {own}: map row ") for line in lines[2:])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["show", "papr"], "No arena is named 'papr': did you mean paper or paper-grid?"),
        (["check", "no/such.toml"], "no/such.toml: there is no such arena file."),
        (
            ["show", "paper", "--png", "no/such/p.png"],
            "no/such/p.png: cannot be written: No such file or directory.",
        ),
    ],
)
def test_wrong_input_exits_with_2_and_one_sentence(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["arena", *arguments]) == 2
    assert capsys.readouterr() == ("", f"robosim: {sentence}\n")


def test_random_shows_an_arena_and_saves_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = tmp_path / "drawn.toml"
    assert main(["arena", "random", "--seed", "7", "--save", str(own)]) == 0
    shown = capsys.readouterr().out
    assert own.read_text() == random_arena(7)
    assert all(row in shown for row in drawing(load_arena(own)))
    assert "random-7" in shown
    assert main(["arena", "random", "--seed", "-1"]) == 2
    assert capsys.readouterr().err == (
        "robosim: seed is -1, but must be a whole number from 0 to 9223372036854775807.\n"
    )
