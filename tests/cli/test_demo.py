from pathlib import Path

import pytest

from robosim.cli.demo import Demo
from robosim.control.policy import load_policy


def test_leaves_a_policy_and_a_recording_and_shows_every_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Demo(out=tmp_path, steps=200).run()
    assert load_policy(tmp_path / "run").robots == 2
    assert (tmp_path / "run.rrd").stat().st_size > 10_000
    printed = capsys.readouterr().out
    commands = [line for line in printed.splitlines() if line.startswith("$ ")]
    assert [command.split()[2] for command in commands] == [
        "train",
        "evaluate",
        "evaluate",
        "evaluate",
        "play",
    ]
    assert "lanes" in commands[2]
    assert "random" in commands[3]


@pytest.mark.slow
def test_a_second_demo_keeps_the_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("mine")
    Demo(out=tmp_path, steps=100).run()
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["run", "run-2", "run-2.rrd"]
    assert (tmp_path / "run" / "mine.txt").read_text() == "mine"
