import subprocess
import sys

import pytest
from rerun.chunk import RrdReader

from robosim.cli.main import main


def test_play_records_and_says_how_to_open_it(tmp_path, capsys):
    path = tmp_path / "run.rrd"
    arguments = ["play", "lanes", "--arena", "paper", "--robots", "2", "--steps", "20", "--seed", "4"]
    assert main([*arguments, "--save", str(path)]) == 0
    printed = capsys.readouterr().out
    assert f"{path}: 20 decisions, 0 pellets, " in printed
    assert f"open it with: rerun {path}" in printed
    reader = RrdReader(path)
    assert (len(reader.recordings()), len(reader.blueprints())) == (1, 1)
    about = {}
    for chunk in reader.stream():
        if chunk.entity_path == "/__properties/robosim":
            batch = chunk.to_record_batch()
            about = {name: batch.column(name).to_pylist()[0] for name in batch.schema.names}
    assert (about["policy"], about["seed"], about["robots"]) == (["lanes"], ["4"], ["2"])


def test_recordings_pass_the_viewers_own_check(tmp_path):
    path = tmp_path / "run.rrd"
    assert main(["play", "random", "--robots", "2", "--steps", "5", "--save", str(path)]) == 0
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(path)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0
    assert "1 file verified without error" in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--save", "nowhere/run.rrd"],
            "Recording 'nowhere/run.rrd': cannot be written (No such file or directory)",
        ),
        (["--save", "run.mp4"], "Recording 'run.mp4': the file name must end in .rrd"),
        (["--steps", "0"], "--steps is 0: it must be at least 1."),
        (["--seed", "-1"], "--seed is -1: it must not be negative."),
        (["--robots", "0"], "robots: 0 is not allowed"),
        (["--arena", "papr"], "paper"),
    ],
)
def test_wrong_input_is_a_sentence_and_leaves_no_file(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["play", "lanes", *arguments]) == 2
    complaint = capsys.readouterr().err
    assert sentence in complaint
    assert complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
