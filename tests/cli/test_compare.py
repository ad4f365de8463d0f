"""`robosim compare` on run folders, results and evaluations."""

import json
import re
from pathlib import Path

import pytest
from matplotlib import image

from robosim.cli.main import main
from robosim.experiments.runs import read_runs
from robosim.experiments.statistics import LEAST_RUNS
from tests.experiments import made


@pytest.fixture
def given(tmp_path):
    """Three seeds of two techniques in folders, and of `lanes` in results."""
    for seed in range(LEAST_RUNS):
        made.folder(tmp_path / "runs" / f"iql+s-{seed}", "iql+s", seed, [4 + seed, 6 + seed])
        made.folder(tmp_path / "runs" / f"ps-dqn-{seed}", "ps-dqn", seed, [9, 9 + seed])
        made.result(tmp_path / "sweep.jsonl", "lanes", seed, [10, 10], learned=False)
    return [str(tmp_path / "runs"), str(tmp_path / "sweep.jsonl")]


def test_a_table_for_each_task(given, capsys):
    assert main(["compare", *given]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "paper (grid world), 2 robots, episodes of 300 decisions: pellets per episode",
        "  system  seeds  episodes  IQM, 95 % interval  share of lanes     better than lanes",
        "  lanes   3      6         10.0 [10.0, 10.0]   1.00 [1.00, 1.00]  -",
        "  ps-dqn  3      6         9.5 [9.0, 10.0]     0.95 [0.90, 1.00]  0.17 [0.00, 0.50]",
        "  iql+s   3      6         6.0 [5.0, 7.0]      0.60 [0.50, 0.70]  0.00 [0.00, 0.00]",
    ]


def test_everything_is_written_where_it_was_asked_for(given, tmp_path, capsys):
    out = tmp_path / "out"
    files = ["--json", str(tmp_path / "out.json"), "--marl-eval", str(tmp_path / "marl.json")]
    for robots in (2, 4):
        made.result(tmp_path / "more.jsonl", "ia2c", 0, [1, 2], robots)
    assert main(["compare", *given, str(tmp_path / "more.jsonl"), *files, "--figures", str(out)]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[-6] == (
        "paper (grid world), 4 robots, episodes of 300 decisions: no runs of lanes here, "
        "so nothing is normalised."
    )
    assert shown[-5:] == [
        "Fewer than 3 seeds say too little for an interval: their scores are printed.",
        "--marl-eval: paper-grid-300 leaves out iql+s, lanes, ps-dqn, since they lack runs of some tasks.",
        f"written: {tmp_path / 'out.json'}",
        f"written: {tmp_path / 'marl.json'}",
        f"written: {out} (improvement, learning-curves, lorenz, pellets, profiles, team-size, touches)",
    ]
    record = json.loads((tmp_path / "out.json").read_text())
    assert [table["task"]["robots"] for table in record["tables"]] == [2, 4]
    rows = {row["system"]: row for row in record["tables"][0]["rows"]}
    assert rows["iql+s"]["scores"] == [5.0, 6.0, 7.0]
    assert rows["iql+s"]["iqm"]["value"] == 6.0
    assert rows["ia2c"]["iqm"] == {"value": 1.5, "low": None, "high": None}
    assert list(json.loads((tmp_path / "marl.json").read_text())["paper-grid-300"]["4-robots"]) == ["ia2c"]
    for name in ("improvement", "learning-curves", "lorenz", "pellets", "profiles", "team-size", "touches"):
        assert image.imread(out / f"{name}.png").std() > 0.01
        assert max((out / f"{name}.{kind}").stat().st_size for kind in ("png", "svg")) < 300_000
    # The systems that have a learning curve, and no others.
    text = (out / "learning-curves.svg").read_text()
    assert {name for name in ("iql+s", "ps-dqn", "ia2c", "lanes") if f">{name}<" in text} == {
        "iql+s",
        "ps-dqn",
        "ia2c",
    }


def test_scores_of_few_seeds_are_printed(tmp_path, capsys):
    made.folder(tmp_path / "a", "iql+s", 0, [4, 6])
    made.folder(tmp_path / "b", "iql+s", 1, [8, 10])
    assert main(["compare", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"iql\+s +2 +4 +7\.0 \(5\.0, 9\.0\) +1\.00 +-\n", shown)
    assert shown.endswith("Fewer than 3 seeds say too little for an interval: their scores are printed.\n")


def test_shares_have_more_decimals_than_pellets(tmp_path, capsys):
    for seed in range(LEAST_RUNS):
        made.result(tmp_path / "sweep.jsonl", "lanes", seed, [10, 10], learned=False)
    text = (tmp_path / "sweep.jsonl").read_text().replace('"touches":[3,3]', '"gini":[0.125,0.125]')
    (tmp_path / "sweep.jsonl").write_text(text)
    assert main(["compare", str(tmp_path / "sweep.jsonl"), "--metric", "gini"]) == 0
    assert re.search(r"lanes +3 +6 +0\.125 \[0\.125, 0\.125\]", capsys.readouterr().out)


def test_runs_under_a_profile_are_told_from_those_without(given, tmp_path, capsys):
    for seed in range(LEAST_RUNS):
        made.result(tmp_path / "noisy.jsonl", "lanes", seed, [7, 7], learned=False, under="robotarium")
        made.result(tmp_path / "noisy.jsonl", "pqn", seed, [3, 4], under="robotarium")
    marl, figures = tmp_path / "marl.json", tmp_path / "figures"
    command = ["compare", *given, str(tmp_path / "noisy.jsonl"), "--marl-eval", str(marl)]
    assert main([*command, "--figures", str(figures)]) == 0
    tables = json.loads(marl.read_text())
    assert list(tables) == ["paper-grid-300", "paper-grid-300-robotarium"]
    runs = [list(tables[place]["2-robots"]["lanes"]) for place in tables]
    assert runs == [["run_1", "run_2", "run_3"]] * 2
    for name in ("team-size", "improvement"):
        text = (figures / f"{name}.svg").read_text()
        # A panel's title is in its text.
        assert "300 decisions, under robotarium" in text


def test_names_in_results_of_strangers_cannot_steer_the_terminal(given, tmp_path, capsys):
    results, evil = tmp_path / "sweep.jsonl", "la\x1b[2J\u009b31m\u202enes\r$\\bad$"
    results.write_text(results.read_text().replace('"lanes"', json.dumps(evil)))
    made.rekey(results)
    made.result(tmp_path / "more.jsonl", "ia2c", 0, [1, 2], 4)
    made_up = made.evaluation([3, 4], controller=evil, world="physics").changed(arena=evil)
    (tmp_path / "one.json").write_text(made_up.model_dump_json())
    files = [*given, str(tmp_path / "one.json"), str(tmp_path / "more.jsonl")]
    assert main(["compare", *files, "--marl-eval", str(tmp_path / "marl.json")]) == 0
    assert all(
        run.system.isprintable() and str(run.task).isprintable() for run in read_runs(map(Path, files))
    )
    shown = capsys.readouterr().out
    assert "  la?[2J?31m?nes?$\\bad$  3 " in shown
    assert "la?[2J?31m?nes?$\\bad$, 2 robots, episodes of 300 decisions: pellets per episode" in shown
    assert all(map(str.isprintable, shown.split("\n")))


def test_wrong_input_is_a_sentence_and_leaves_nothing(given, tmp_path, capsys):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    bare = made.folder(tmp_path / "bare", "iql+s", 9, [4])
    (bare / "evaluation.json").unlink()
    before = sorted(tmp_path.rglob("*"))
    out = ["--json", str(tmp_path / "out.json"), "--figures", str(tmp_path / "out")]
    for options, sentence in (
        ([], "compare needs runs: give run folders, results of sweeps or evaluations."),
        (
            [str(bare)],
            (
                f"{bare}: this run has no evaluation (evaluation.json): it was trained without; "
                f"`robosim evaluate {bare} --json FILE` makes one."
            ),
        ),
        (
            [*given, "--metric", "gini"],
            '--metric: no run has a figure "gini": known names are pellets, touches.',
        ),
        (
            [*given, "--marl-eval", str(tmp_path / "out.json")],
            (
                f"--json and --marl-eval are both {tmp_path / 'out.json'}, but must be two places: one would "
                "replace the other."
            ),
        ),
        (
            [*given, "--marl-eval", given[1]],
            f"--marl-eval is {given[1]}, but must be another file than those that are read.",
        ),
        (
            [*given, "--marl-eval", str(tmp_path / "runs" / "iql+s-0" / "evaluation.json")],
            (
                f"--marl-eval is {tmp_path / 'runs' / 'iql+s-0' / 'evaluation.json'}, but must be another "
                "file than those that are read."
            ),
        ),
        (
            [*given, "--marl-eval", str(tmp_path / "out" / "marl.json")],
            (
                f"--marl-eval is {tmp_path / 'out' / 'marl.json'}, but must not lie in the new folder "
                f"{tmp_path / 'out'}."
            ),
        ),
        ([*given, "--baseline", "lane"], '--baseline: no run is of "lane": did you mean lanes?'),
        (
            [*given, "--figures", str(tmp_path / "full")],
            f"{tmp_path / 'full'}: this folder is not empty; a report needs a new one.",
        ),
    ):
        assert main(["compare", *out, *options]) == 2
        assert capsys.readouterr() == ("", f"robosim: {sentence}\n")
    assert sorted(tmp_path.rglob("*")) == before
