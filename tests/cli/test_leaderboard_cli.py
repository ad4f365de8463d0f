"""`robosim leaderboard`: tables, those asked for, and a page of docs that is what it prints."""

import json
from pathlib import Path

import pytest

from robosim.cli.main import main
from tests.experiments import made

PAGE = Path(__file__).parents[2] / "docs" / "leaderboard.md"


def test_the_page_is_what_the_command_writes_into_it(tmp_path, capsys):
    page = tmp_path / "page.md"
    text = PAGE.read_text(encoding="utf-8")
    page.write_text(text.partition("\n## ")[0] + "\n## old\n", encoding="utf-8")
    assert main(["leaderboard", "--into", str(page)]) == 0
    assert capsys.readouterr().out == f"written: {page}\n"
    # After new records: robosim leaderboard --into docs/leaderboard.md
    assert page.read_text(encoding="utf-8") == text


def test_a_page_without_tables_is_left_as_it_is(tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text("# Mine\n")
    assert main(["leaderboard", "--arena", "single-lane", "--into", str(page)]) == 2
    assert capsys.readouterr().err == (
        f"robosim: {page}: has no heading of the second level, from which on it could be replaced.\n"
    )
    assert page.read_text() == "# Mine\n"


def test_an_evaluation_of_ones_own_stands_among_those_asked_for(tmp_path, capsys):
    mine, out = tmp_path / "mine.json", tmp_path / "board.json"
    command = [
        "evaluate",
        "random",
        "--arena",
        "single-lane",
        "--robots",
        "2",
        "--episodes",
        "3",
        "--steps",
        "5",
    ]
    assert main([*command, "--json", str(mine)]) == 0
    capsys.readouterr()
    options = ["--records", str(mine), "--arena", "single-lane", "--robots", "2", "--json", str(out)]
    assert main(["leaderboard", *options]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "single-lane, 2 robots, episodes of 5 decisions:"
    assert shown[2].split() == ["1", "random", "scripted", "1", "-", "0.0", "[0.0,", "0.0]", "-", "mine.json"]
    assert shown[4].startswith("single-lane, 2 robots, episodes of ")
    assert shown[6].split()[:2] == ["-", "single-lane-2"]
    entries = json.loads(out.read_text())["entries"]
    assert [(one["system"], one["source"]) for one in entries] == [
        ("random", "mine.json"),
        ("single-lane-2", "robosim"),
    ]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--arena", "papr"], '--arena: there is no entry for "papr": did you mean paper or paper-grid?'),
        (
            ["--arena", "robotarium", "--robots", "9"],
            "--robots is 9, but there are entries for 4 alone.",
        ),
        (
            ["--records", "nowhere.jsonl"],
            "nowhere.jsonl: there is no such run folder, results file or evaluation.",
        ),
    ],
)
def test_what_there_is_not_is_a_sentence(options, sentence, capsys):
    assert main(["leaderboard", *options]) == 2
    assert capsys.readouterr() == ("", f"robosim: {sentence}\n")


def test_nothing_that_is_read_is_replaced(tmp_path, capsys):
    records, page = tmp_path / "mine.jsonl", tmp_path / "page.md"
    made.result(records, "lanes", 0, [10, 10], learned=False)
    before = records.read_text()
    for options, option, path in (
        (["--json", str(records)], "--json", records),
        (["--into", str(records)], "--into", records),
    ):
        assert main(["leaderboard", "--records", str(records), *options]) == 2
        sentence = f"{option} is {path}, but must be another file than those that are read."
        assert capsys.readouterr() == ("", f"robosim: {sentence}\n")
    assert main(["leaderboard", "--json", str(page), "--into", str(page)]) == 2
    sentence = f"--json and --into are both {page}, but must be two places: one would replace the other."
    assert capsys.readouterr() == ("", f"robosim: {sentence}\n")
    assert records.read_text() == before
    assert not page.exists()


def test_names_in_records_of_strangers_cannot_steer_the_terminal(tmp_path, capsys):
    evil = "my\x1b[2J\u009bteam"
    (tmp_path / "mine\x1b.json").write_text(made.evaluation([3, 4], controller=evil).model_dump_json())
    options = ["--records", str(tmp_path / "mine\x1b.json"), "--arena", "paper", "--robots", "2"]
    assert main(["leaderboard", *options, "--markdown"]) == 0
    shown = capsys.readouterr().out
    assert "| my?[2J?team |" in shown
    assert "| mine?.json |" in shown
    assert all(map(str.isprintable, shown.split("\n")))
