"""Progress is shown to a person who waits, and to nobody else."""

import contextlib
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from robosim.cli.progress import each, progress

COMMAND = ["evaluate", "lanes", "--robots", "1", "--episodes", "1", "--steps", "60"]


def run(folder: Path, stderr: int) -> subprocess.Popen[str]:
    with (folder / "out.txt").open("w") as out:
        return subprocess.Popen(
            [sys.executable, "-m", "robosim", *COMMAND, "--json", "out.json"],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TERM": "xterm", "COLUMNS": "120"},
            stdout=out,
            stderr=stderr,
            text=True,
        )


def everything_on(screen: int) -> str:
    """Return what is written to a terminal until nobody has it open any more."""
    shown = b""
    with contextlib.suppress(OSError):
        while part := os.read(screen, 65536):
            shown += part
    return shown.decode()


def test_in_a_terminal_a_bar_moves_and_what_is_piped_and_written_stays_the_same(tmp_path: Path) -> None:
    piped, terminal = tmp_path / "piped", tmp_path / "terminal"
    piped.mkdir()
    terminal.mkdir()
    with run(piped, subprocess.PIPE) as process:
        assert process.stderr is not None
        assert process.stderr.read() == ""
    leader, follower = pty.openpty()
    with run(terminal, follower) as process:
        os.close(follower)
        shown = everything_on(leader)
    os.close(leader)
    assert "evaluating" in shown
    assert "pellets an episode so far" in shown
    for name in ("out.txt", "out.json"):
        assert (terminal / name).read_text() == (piped / name).read_text() != ""


def test_what_is_waited_for_comes_one_by_one_and_its_failure_through(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def cases():
        yield 1
        yield 2
        raise ValueError("no third")

    found = []
    with pytest.raises(ValueError, match="no third"):
        found.extend(each("measuring", cases(), 3))
    assert list(each("measuring", [1, 2, 3])) == [1, 2, 3]
    with progress("working") as show:
        show(1, "figures")
    assert capsys.readouterr() == ("", "")
