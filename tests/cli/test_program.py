"""What hints print works as printed."""

import subprocess
import sys
from pathlib import Path

import pytest

from robosim.cli.program import hint

COMMANDS = Path(sys.executable).parent


def test_on_the_path_the_name_alone_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(COMMANDS))
    assert hint("view", "my run.rrd") == "robosim view 'my run.rrd'"


def test_off_the_path_or_behind_another_robosim_where_it_lies_is_printed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    other = tmp_path / "robosim"
    other.write_text("#!/bin/sh\n")
    other.chmod(0o755)
    for path in ("", str(tmp_path)):
        monkeypatch.setenv("PATH", path)
        monkeypatch.chdir(tmp_path)
        assert hint("view", "run.rrd") == f"{COMMANDS / 'robosim'} view run.rrd"
        monkeypatch.chdir(COMMANDS.parent)
        assert hint("view", "run.rrd") == f"{COMMANDS.name}/robosim view run.rrd"


def test_the_command_runs_as_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    done = subprocess.run(f"{hint()} --version", shell=True, capture_output=True, text=True)
    assert (done.returncode, done.stdout.split()[0]) == (0, "robosim")
