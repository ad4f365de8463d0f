"""`robosim view`: the viewer itself, as a process of its own."""

import os
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from robosim.cli.main import main
from robosim.cli.program import hint
from robosim.playback import viewer

NO_DISPLAY = "there is no display for the viewer's window: a browser can show it instead"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "run.rrd"
    assert main(["play", "random", "--robots", "2", "--steps", "5", "--save", str(path)]) == 0
    return path


def headless() -> dict[str, str]:
    """Return the environment of a process that has no display."""
    hidden = {"DISPLAY", "WAYLAND_DISPLAY", "BROWSER"}
    return {name: value for name, value in os.environ.items() if name not in hidden}


@pytest.fixture(autouse=True)
def heard_interrupts() -> Iterator[None]:
    """Let processes hear SIGINT: what a shell runs in the background, and its children, ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def free_port() -> int:
    """Return a port that is free, and so is the next."""
    while True:
        with socket.socket() as one, socket.socket() as other:
            one.bind(("127.0.0.1", 0))
            port = one.getsockname()[1]
            try:
                other.bind(("127.0.0.1", port + 1))
            except (OSError, OverflowError):
                continue
            return int(port)


def listening(port: int) -> set[str]:
    """Return the addresses, as the system writes them, at which something listens."""
    tables = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
    lines = [line.split() for table in tables for line in table.read_text().splitlines()[1:]]
    sockets = [line[1:4:2] for line in lines if line[3] == "0A"]
    return {place.partition(":")[0] for place, _ in sockets if int(place.partition(":")[2], 16) == port}


@pytest.mark.skipif(sys.platform != "linux", reason="reads the system's table of sockets")
@pytest.mark.parametrize(("options", "ending"), [((), signal.SIGTERM), (("--web",), signal.SIGINT)])
def test_without_a_display_or_by_choice_a_browser_is_served_on_this_machine_alone(
    recorded: Path, options: tuple[str, ...], ending: signal.Signals
) -> None:
    port = free_port()
    command = [sys.executable, "-m", "robosim", "view", str(recorded), "--port", str(port), *options]
    with subprocess.Popen(command, env=headless(), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            said = []
            for line in process.stdout:
                said.append(line.rstrip("\n"))
                if line == "Ctrl-C ends it\n":
                    break
            address = f"http://127.0.0.1:{port}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port + 1}%2Fproxy"
            assert said == [
                *([] if options else [NO_DISPLAY]),
                f"open this in a browser: {address}",
                "Ctrl-C ends it",
            ]
            with urllib.request.urlopen(address) as page:
                assert "Rerun SDK-bundled web viewer" in page.read().decode()
            # 127.0.0.1, and nothing else.
            assert listening(port) == listening(port + 1) == {"0100007F"}
            process.send_signal(ending)
            assert process.wait(timeout=20) == 0
        finally:
            process.terminate()
    assert listening(port) == listening(port + 1) == set()


def test_a_viewer_that_does_not_end_when_told_to_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "_GRACE", 0.2)
    deaf = "import signal as s, time; s.signal(s.SIGTERM, s.SIG_IGN); print(1, flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"1\n"
        viewer._end(process)
    assert process.returncode == -signal.SIGKILL


def test_a_viewer_that_cannot_open_its_window_is_no_success(recorded: Path) -> None:
    env = {**headless(), "DISPLAY": ":98765"}
    command = [sys.executable, "-m", "robosim", "view", str(recorded)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "robosim: the viewer has failed (exit code 1); what it said is above."
    )


def test_a_taken_port_is_a_sentence(
    recorded: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1] - 1
        assert main(["view", str(recorded), "--web", "--port", str(port)]) == 2
    assert capsys.readouterr().err == (
        f"robosim: --port is {port}, but it or the next, which is needed too, is taken.\n"
    )


def test_without_a_recording_it_names_the_latest_or_how_to_make_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gone.rrd").symlink_to("nowhere")
    assert main(["view"]) == 2
    made = hint("play", "paper-8", "--save", "run.rrd")
    assert capsys.readouterr().err == f"robosim: view needs a recording: `{made}` makes one.\n"
    for name, time in (("a.rrd", 1000.0), ("my run.rrd", 3000.0), ("z.rrd", 2000.0)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (time, time))
    assert main(["view"]) == 2
    opened = hint("view", "my run.rrd")
    assert capsys.readouterr().err == (
        f"robosim: view needs a recording: the latest here is opened by `{opened}`.\n"
    )


def _cut(path: Path, recorded: Path) -> None:
    path.write_bytes(recorded.read_bytes()[:-1000])


@pytest.mark.parametrize(
    ("name", "make", "sentence"),
    [
        ("run.rrd", lambda path, recorded: None, "there is no such recording."),
        ("run.rrd", lambda path, recorded: path.mkdir(), "this is no file, so it is no recording."),
        ("run.rrd", lambda path, recorded: os.mkfifo(path), "this is no file, so it is no recording."),
        ("run.rrd", lambda path, recorded: path.write_text(""), "is no recording, or not a whole one ("),
        (
            "run.rrd",
            lambda path, recorded: path.write_text("hi" * 99),
            "is no recording, or not a whole one (",
        ),
        ("run.rrd", _cut, "is no recording, or not a whole one ("),
        (
            "run.npz",
            lambda path, recorded: np.savez(path, seed=0),
            "a trajectory is no recording; `robosim play` makes one of it.",
        ),
        (
            "run.jsonl",
            lambda path, recorded: path.write_text("{}\n"),
            "a controller's log is no recording; `robosim play` makes one of it.",
        ),
    ],
)
def test_what_is_no_recording_is_refused_in_a_sentence(
    tmp_path: Path, recorded: Path, capsys: pytest.CaptureFixture[str], name: str, make, sentence: str
) -> None:
    path = tmp_path / name
    make(path, recorded)
    assert main(["view", str(path), "--web"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.startswith(f"robosim: {path}: {sentence}")
    assert complaint.count("\n") == 1
