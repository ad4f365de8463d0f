"""`robosim evaluate` with and without a report."""

import itertools
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robosim.cli.main import main
from robosim.control.policy import find_policy
from robosim.experiments.runs import read_runs

SHORT = ["evaluate", "lanes", "--arena", "paper", "--robots", "2", "--episodes", "2", "--steps", "20"]


def test_a_report_is_written_and_its_main_figures_are_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*SHORT, "--report", "out", "--json", "out.json"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "lanes in paper, 2 robots, 2 episodes of 20 decisions:"
    assert shown[3] == "  without a delivery      at most 20 decisions, in episode 0"
    assert shown[6:] == [
        "  time clogged            0.0 %, no clogs",
        "  strategy                neither One-at-a-Time nor Bucket-Brigade in 2 of 2 episodes",
        "  report                  out/index.html",
    ]
    assert Path("out/index.html").exists()
    record = json.loads(Path("out/metrics.json").read_text())
    assert record["evaluation"] == json.loads(Path("out.json").read_text())
    assert record["command"] == (
        "robosim evaluate lanes --arena paper --robots 2 --episodes 2 --steps 20 --seed 0 --report FOLDER"
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "out.json"]
    assert main(["play", "out/episodes/1.npz", "--save", "run.rrd"]) == 0
    assert "20 decisions" in capsys.readouterr().out


def test_two_outputs_in_one_place_are_refused_before_the_episodes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*SHORT, "--report", "out", "--robustness", "out"]) == 2
    assert capsys.readouterr().err == (
        "robosim: --report and --robustness are both out, but must be two places: one would replace "
        "the other.\n"
    )
    assert not list(tmp_path.iterdir())


def test_names_of_strangers_cannot_steer_the_terminal(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    team = "team\x1b[2J"
    shutil.copytree(find_policy("paper-2"), team)
    Path("own.toml").write_text('name = "calm\\u001b[31m\\u009b"\n[sensing]\ndropout = 0.1\n')
    options = ["--profile", "own.toml", "--episodes", "1", "--steps", "5"]
    for teams in ([team], [team, "lanes"]):
        assert main(["evaluate", *teams, *options]) == 0
        shown = capsys.readouterr().out
        assert "team?[2J" in shown
        assert "profile calm?[31m?" in shown
        assert all(map(str.isprintable, shown.split("\n")))


def test_without_a_report_nothing_is_watched_and_nothing_else_is_printed(capsys):
    code = (
        "import sys; from robosim.cli.main import main; "
        f"main({SHORT!r}); "
        "print(sorted(name for name in sys.modules if name.startswith('robosim.analysis')), "
        "'matplotlib' in sys.modules, 'pyarrow' in sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    lines = result.stdout.splitlines()
    assert [line.split("  ")[1] for line in lines[1:-1]] == [
        "pellets per episode",
        "of each robot",
        "without a delivery",
        "collisions per episode",
        "closest, centres",
    ]
    assert lines[-1] == "[] False False"


@pytest.mark.parametrize("steps", ["0", "-1"])
def test_an_episode_has_a_decision_at_least(steps, capsys):
    assert main(["evaluate", "lanes", "--episodes", "1", "--steps", steps]) == 2
    assert capsys.readouterr().err == (
        f"robosim: --steps is {steps}, but must be a whole number from 1 to 100000000.\n"
    )


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ("full", "this folder is not empty; a report needs a new one."),
        ("file", "this is a file; a report needs a folder."),
        ("file/out", "the report cannot be written: Not a directory."),
    ],
)
def test_a_place_that_will_not_do_is_refused_before_any_episode(tmp_path, monkeypatch, capsys, place, why):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    (tmp_path / "file").touch()
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setattr("robosim.control.evaluate.evaluate", lambda *_, **__: pytest.fail("an episode ran"))
    assert main([*SHORT, "--report", str(tmp_path / place)]) == 2
    assert capsys.readouterr() == ("", f"robosim: {tmp_path / place}: {why}\n")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_full_disk_costs_the_report_but_not_the_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("robosim.analysis.report.writer.FIGURES", ())
    monkeypatch.setattr("robosim.analysis.report.page.FIGURES", ())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3_000, limits[1]))
        code = main([*SHORT, "--report", str(tmp_path / "out")])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    shown = capsys.readouterr()
    assert code == 2
    assert shown.err == f"robosim: {tmp_path}/out: the report cannot be written: File too large.\n"
    assert "pellets per episode" in shown.out
    assert "time clogged" in shown.out
    assert "index.html" not in shown.out
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_leaves_nothing_behind(tmp_path, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("robosim.analysis.report.writer.FIGURES", ())
    monkeypatch.setattr("robosim.analysis.report.page.FIGURES", ())
    monkeypatch.setattr("robosim.analysis.report.writer.trip_table", interrupt)
    assert main([*SHORT, "--report", str(tmp_path / "out")]) == 130
    assert list(tmp_path.iterdir()) == []


def test_equal_commands_write_equal_bytes_in_any_process(tmp_path):
    command = ["evaluate", "active", "--arena", "single-lane", "--robots", "3", "--episodes", "2"]
    command += ["--steps", "60", "--report"]
    assert main([*command, str(tmp_path / "1")]) == 0
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    other = [sys.executable, "-m", "robosim", *command, "2"]
    subprocess.run(other, cwd=tmp_path, env=environment, timeout=60, check=True)
    first, second = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path / "1", tmp_path / "2")
    )
    assert first == second
    assert len(first) == 28


SEVERAL = ["--arena", "paper", "--robots", "2", "--episodes", "3", "--steps", "200"]


def test_several_teams_stand_in_one_table_with_what_each_does_alone(tmp_path, capsys):
    teams = ["active", "paper-2", "random"]
    for team in teams:
        assert main(["evaluate", team, *SEVERAL, "--json", str(tmp_path / f"{team}.json")]) == 0
    capsys.readouterr()
    assert main(["evaluate", *teams, *SEVERAL, "--json", str(tmp_path / "all.json")]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "3 episodes each of 200 decisions, seed 0:"
    assert shown[1].split("  ")[1].strip() == "team"
    assert [line.split()[:3] for line in shown[2:]] == [[team, "paper", "2"] for team in teams]
    records = json.loads((tmp_path / "all.json").read_text())
    for team, record, line in zip(teams, records, shown[2:], strict=True):
        alone = json.loads((tmp_path / f"{team}.json").read_text())
        assert record["evaluation"] == alone
        totals = [sum(episode) for episode in alone["delivered"]]
        figures = record["pellets"]
        assert figures["value"] == pytest.approx(np.mean(totals))
        # Of the 27 equally likely ways to draw three episodes, the extremes are each more than 2.5 %.
        ways = np.mean(list(itertools.product(totals, repeat=3)), axis=1)
        assert (figures["low"], figures["high"]) == pytest.approx((ways.min(), ways.max()))
        assert f"{figures['value']:.1f} [{figures['low']:.1f}, {figures['high']:.1f}]" in line
    assert len({tuple(map(str, record["pellets"].values())) for record in records}) > 1
    runs = read_runs([tmp_path / "all.json"])
    assert [(run.technique, run.figures["pellets"]) for run in runs] == [
        (team, tuple(sum(episode) for episode in record["evaluation"]["delivered"]))
        for team, record in zip(teams, records, strict=True)
    ]


def test_few_episodes_have_no_interval_and_teams_may_differ_in_arena_and_size(capsys):
    assert main(["evaluate", "paper-2", "three-wide-4", "--episodes", "1", "--steps", "10"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line.split()[:4] for line in shown[2:]] == [
        ["paper-2", "paper", "2", "0.0"],
        ["three-wide-4", "three-wide", "4", "0.0"],
    ]
    assert "[" not in "".join(shown)


NO_TEAM = (
    "evaluate needs a team: a run folder of yours, a trained policy that `robosim policy list` names, or a "
    "scripted controller: lanes, active, reversal, lorenz, random."
)


@pytest.mark.parametrize(
    ("teams", "sentence"),
    [
        ([], NO_TEAM),
        (
            ["lanes", "active", "--report", "out"],
            "--report is about one team, but 2 are given: evaluate them one by one.",
        ),
        (
            ["lanes"] * 7 + ["--robustness", "out"],
            "--robustness draws at most 6 teams, but 7 are given.",
        ),
        (["lanes", "nobody"], "no policy is named 'nobody', and there is no such folder: did you mean any?"),
        (
            ["lanes", "paper-4-smadrl", "--robots", "2"],
            "policy paper-4-smadrl does not fit arena 'paper': robots was 4 in training and is 2 here.",
        ),
    ],
)
def test_a_mistake_in_any_of_several_is_said_before_an_episode_runs(teams, sentence, monkeypatch, capsys):
    monkeypatch.setattr("robosim.control.evaluate.evaluate", lambda *_, **__: pytest.fail("an episode ran"))
    assert main(["evaluate", *teams]) == 2
    assert capsys.readouterr().err == f"robosim: {sentence}\n"
