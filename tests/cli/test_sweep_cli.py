import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robosim.cli.main import main
from robosim.cli.program import hint
from robosim.experiments.results import read_results
from robosim.experiments.sweep import read_sweep
from tests.cli import broken_reward
from tests.processes import hearing_ctrl_c

MIXED = """
[options]
world = "grid"
[vary]
technique = ["lanes", "active"]
robots = [2, 3, 4]
[[where]]
match = { technique = "active", robots = 3 }
skip = "too many"
[[where]]
match = { technique = "lanes", robots = 4 }
skip = "too many"
[[where]]
match = { technique = "active", robots = 4 }
options = { extra_reward = "broken" }
[evaluation]
episodes = 2
steps = 60
"""
LONG = """
[options]
technique = "iql"
world = "grid"
steps = 3000
num_envs = 2
updates_per_step = 0.05
hidden = [8]
robots = 2
[evaluation]
episodes = 1
steps = 50
"""


@pytest.fixture
def sweep(tmp_path, monkeypatch):
    # Worker processes import it by its name.
    monkeypatch.setenv("ROBOSIM_PLUGINS", broken_reward.__name__)
    path = tmp_path / "mixed.toml"
    path.write_text(MIXED)
    return path


def test_a_dry_run_says_what_there_is_to_do_and_does_nothing(sweep, capsys):
    assert main(["sweep", str(sweep), "--dry-run", "--workers", "2"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "to do    technique=lanes robots=2",
        "to do    technique=lanes robots=3",
        "skipped  technique=lanes robots=4: too many",
        "to do    technique=active robots=2",
        "skipped  technique=active robots=3: too many",
        "to do    technique=active robots=4",
        "0 done, 4 to do, 2 skipped",
        "no run is done yet that would tell how long the rest takes",
    ]
    assert [path.name for path in sweep.parent.iterdir()] == ["mixed.toml"]


def test_a_strangers_sweep_cannot_steer_the_terminal(tmp_path, capsys):
    path = tmp_path / "odd.toml"
    path.write_text(
        '[options]\nworld = "grid"\n[vary]\ntechnique = ["lanes"]\nrobots = [2]\n'
        'note = ["a\\u001b[2J\\u009b"]\n'
        '[[where]]\nmatch = { robots = 2 }\nskip = "too\\u001b[31m many"\n'
    )
    assert main(["sweep", str(path), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert "too?[31m many" in shown
    assert all(map(str.isprintable, shown.split("\n")))


def test_a_run_that_cannot_be_done_is_said_and_the_others_are_done_and_not_done_again(sweep, capsys):
    folder = sweep.parent
    out = ["--out", str(folder / "runs")]
    assert main(["sweep", str(sweep), *out, "--workers", "2"]) == 1
    said = capsys.readouterr()
    assert (
        'technique=active robots=4  failed: extra reward "broken" returned an array of type float64 and '
        in said.out
    )
    assert f"3 runs done, 2 skipped; results in {folder / 'mixed.results.jsonl'}" in said.out
    first, last = said.err.splitlines()
    assert first.startswith('technique=active robots=4: extra reward "broken" returned an array')
    assert last == "robosim: 1 run failed; the same command tries again."

    found = read_results(folder / "mixed.results.jsonl")
    assert len(found) == 3
    assert sorted(
        (one.config["run"]["technique"], one.config["env"]["robots"]) for one in found.values()
    ) == [
        ("active", 2),
        ("lanes", 2),
        ("lanes", 3),
    ]
    lines = (folder / "mixed.results.jsonl").read_text().splitlines()
    assert max(map(len, lines)) < 3000

    assert main(["sweep", str(sweep), "--dry-run"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed[:6]] == ["done", "done", "skipped", "done", "skipped", "to"]
    assert listed[6] == "3 done, 1 to do, 2 skipped"
    assert listed[7].startswith("about 0:")
    assert listed[7].endswith(" by the 3 runs done")

    # What is left out now tells, too, how long the rest takes.
    assert main(["sweep", str(sweep), "--dry-run", "--only", "robots=4,technique=active"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert listed[:2] == ["to do    technique=active robots=4", "0 done, 1 to do, 0 skipped"]
    assert listed[2].startswith("about 0:")
    assert listed[2].endswith(" by the 3 runs done")

    # Without its line a run is done again, to the same numbers; --only leaves the others alone.
    lanes = next(line for line in lines if '"lanes"' in line and '"robots":3' in line)
    (folder / "mixed.results.jsonl").write_text("\n".join(line for line in lines if line != lanes) + "\n")
    only = ["--only", "technique=lanes", "--no-keep-runs"]
    assert main(["sweep", str(sweep), *out, *only]) == 0
    assert "2 runs done, 1 skipped" in capsys.readouterr().out
    again = json.loads((folder / "mixed.results.jsonl").read_text().splitlines()[-1])
    before = json.loads(lanes)
    assert {name: again[name] for name in ("key", "config", "figures", "series")} == {
        name: before[name] for name in ("key", "config", "figures", "series")
    }
    assert not (folder / "runs" / again["key"][:16]).exists()


@pytest.mark.slow
def test_ctrl_c_saves_and_the_same_command_goes_on(tmp_path, capsys):
    path = tmp_path / "long.toml"
    path.write_text(LONG)
    command = ["sweep", str(path), "--out", str(tmp_path / "runs"), "--workers", "1"]
    process = subprocess.Popen(
        hearing_ctrl_c(*command),
        cwd=Path(__file__).parents[2],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    deadline = time.monotonic() + 60.0
    # Written at once as learning begins, some seconds before its end.
    while not list((tmp_path / "runs").glob("*/work/run/tensorboard/*")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == "robosim: interrupted\n"
    assert out == f"begun: technique=iql\nStopped; go on with: {hint()}\n"
    assert not (tmp_path / "long.results.jsonl").exists()
    (run,) = (tmp_path / "runs").glob("*/work/run")
    assert list((run / "checkpoints").iterdir())
    assert not (run / "finished.json").exists()

    assert main(command) == 0
    assert "1 run done, 0 skipped" in capsys.readouterr().out
    (result,) = read_results(tmp_path / "long.results.jsonl").values()
    assert result.series["learned"][-1] == 3000.0
    assert (run / "policy" / "card.json").exists()
    assert not (run / "checkpoints").exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--workers", "0"], "--workers is 0, but must be a whole number from 1 to 4096."),
        (["--address", "auto"], "--address names a Ray cluster: it needs --engine ray."),
        (["--device", "tpu"], 'device is "tpu", but must be "cpu", or "cuda" for a GPU.'),
        (
            ["--device", "cpu", "--engine", "ray"],
            "--device is for the processes of this machine: it needs --engine local.",
        ),
        (["--workers", "x"], '--workers is "x", but must be a whole number; see robosim sweep --help.'),
        (["--only", "robot=2"], '--only: "robot" is in no run: did you mean robots?'),
    ],
)
def test_a_wrong_option_is_a_sentence(sweep, capsys, options, sentence):
    assert main(["sweep", str(sweep), *options]) == 2
    assert capsys.readouterr().err == f"robosim: {sentence}\n"
    assert [path.name for path in sweep.parent.iterdir()] == ["mixed.toml"]


def test_a_damaged_record_is_a_sentence(sweep, capsys):
    results = sweep.parent / "mixed.results.jsonl"
    key = read_sweep(sweep).jobs[0].key
    results.write_text(f'{{"key":"{key}","config":{{}},"figures":{{}},"wall_time":1,"machine":{{}}}}\n')
    for more in (["--dry-run"], []):
        assert main(["sweep", str(sweep), "--out", str(sweep.parent / "runs"), *more]) == 2
        assert capsys.readouterr().err == (
            f"robosim: {results}: line 1 is no result (its key is not the SHA-256 of its config, "
            "so one of them is damaged).\n"
        )
    assert not (sweep.parent / "runs").exists()


def test_without_ray_a_sentence_says_what_to_install(sweep, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "robosim.experiments.ray_engine", raising=False)
    assert main(["sweep", str(sweep), "--engine", "ray"]) == 2
    assert capsys.readouterr().err == (
        "robosim: this needs ray, which is not installed: install robosim with its extra `cluster`, "
        "in a checkout by: pip install '.[cluster]'.\n"
    )
    assert [path.name for path in sweep.parent.iterdir()] == ["mixed.toml"]
