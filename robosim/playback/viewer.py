"""The viewer that comes with rerun: in a window, or in a browser where no window can be opened.

Whatever it listens at, it listens at this machine's own address alone: nobody else on a network reaches it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import rerun_cli

from robosim.errors import IncompleteError, InputError

HOST = "127.0.0.1"
PORT = 9090
"""Where a browser finds the viewer, unless something else is there; its data comes from the next port."""
_PATIENCE = 30.0
"""How long a viewer may take to listen, s."""
_GRACE = 5.0
"""How long a viewer may take to end by itself, s."""

Say = Callable[[str], None]


def has_display() -> bool:
    """Return whether a window can be opened here."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def viewer_program() -> Path:
    """Return the viewer that belongs to the installed rerun-sdk, wherever its command may be."""
    folder = Path(rerun_cli.__file__).parent
    if sys.platform == "darwin":
        bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
        if bundled.exists():
            return bundled
    program = folder / ("rerun.exe" if sys.platform == "win32" else "rerun")
    if not program.exists():
        raise InputError(f"{program}: the viewer is missing, though rerun-sdk brings it; install that anew.")
    return program


class Ports(NamedTuple):
    """Where a viewer in a browser is served."""

    page: int
    data: int

    @property
    def address(self) -> str:
        """What a person opens in the browser."""
        return f"http://{HOST}:{self.page}/?url=rerun%2Bhttp%3A%2F%2F{HOST}%3A{self.data}%2Fproxy"


def show(recording: Path, *, web: bool, port: int | None, say: Say) -> None:
    """Open a recording in the viewer, and return when the viewer is closed, or interrupted.

    With `web`, and where there is no display, a browser shows it: `say` is told the address. The page is
    served at `port` and its data at the port after that, by default at `PORT` or where it is free.
    InputError if a port is taken, IncompleteError if the viewer fails.
    """
    with _sigterm_as_interrupt(), contextlib.suppress(KeyboardInterrupt):
        if web or not has_display():
            if not web:
                say("there is no display for the viewer's window: a browser can show it instead")
            ports = free_ports(port)
            with served(ports, [str(recording.resolve())]) as viewer:
                _offer(ports, say)
                say("Ctrl-C ends it")
                _wait(viewer)
        else:
            with _running([*_window_at(*_free_ports(1)), str(recording.resolve())]) as viewer:
                _wait(viewer)


def free_ports(port: int | None) -> Ports:
    """Return where to serve a browser; InputError if something else is at the `port` that is asked for."""
    wanted = PORT if port is None else port
    if all(_is_free(one) for one in (wanted, wanted + 1)):
        return Ports(wanted, wanted + 1)
    if port is not None:
        raise InputError(f"--port is {port}, but it or the next, which is needed too, is taken.")
    return Ports(*_free_ports(2))


@contextlib.contextmanager
def served(ports: Ports, recordings: Sequence[str] = ()) -> Iterator[subprocess.Popen[bytes]]:
    """Serve the viewer to browsers, and to it what is recorded or sent to the data's port meanwhile."""
    arguments = ["--serve-web", "--bind", HOST, "--server-memory-limit", "50%"]
    arguments += ["--web-viewer-port", str(ports.page), "--port", str(ports.data)]
    with _running([*arguments, *recordings]) as viewer:
        for port in ports:
            wait_until_listening(viewer, port)
        yield viewer


@contextlib.contextmanager
def live_viewer(say: Say, *, lingers: bool) -> Iterator[str]:
    """Give the URL at which a viewer takes what is recorded meanwhile.

    A window stays open after the block. Where there is no display a browser is served instead, and `say` is
    told the address; with `lingers` it is served after the block, too, until Ctrl-C or SIGTERM.
    """
    if has_display():
        (port,) = _free_ports(1)
        window = start(_window_at(port), stays=True)
        try:
            wait_until_listening(window, port)
        except BaseException:
            _end(window)
            raise
        yield _proxy(port)
        return
    say("there is no display for the viewer's window: a browser can show it instead")
    ports = free_ports(None)
    with contextlib.ExitStack() as stack:
        if lingers:
            stack.enter_context(_sigterm_as_interrupt())
        viewer = stack.enter_context(served(ports))
        _offer(ports, say)
        yield _proxy(ports.data)
        if lingers:
            say("Ctrl-C ends the viewer")
            with contextlib.suppress(KeyboardInterrupt):
                _wait(viewer)


def _window_at(port: int) -> list[str]:
    return ["--bind", HOST, "--port", str(port), "--hide-welcome-screen"]


def _proxy(port: int) -> str:
    return f"rerun+http://{HOST}:{port}/proxy"


def _offer(ports: Ports, say: Say) -> None:
    """Open a browser, if there is one, and tell the address in any case."""
    opened = (has_display() or bool(os.environ.get("BROWSER"))) and webbrowser.open(ports.address)
    say(f"{'a browser opens' if opened else 'open this in a browser:'} {ports.address}")


@contextlib.contextmanager
def _running(arguments: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run the viewer as long as the block does."""
    viewer = start(arguments)
    try:
        yield viewer
    finally:
        _end(viewer)


def _end(viewer: subprocess.Popen[bytes]) -> None:
    viewer.terminate()
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            viewer.wait(_GRACE)
    finally:
        # After a second Ctrl-C, too; one that has ended hears nothing of it.
        viewer.kill()
        viewer.wait()


def start(arguments: Sequence[str], *, stays: bool = False) -> subprocess.Popen[bytes]:
    """Start the viewer; with `stays` an interrupt of this process does not end it."""
    quiet = {"RUST_LOG": "error", **os.environ}
    command = [str(viewer_program()), *arguments]
    return subprocess.Popen(command, env=quiet, start_new_session=stays)  # noqa: S603  # the package's own


def wait_until_listening(viewer: subprocess.Popen[bytes], port: int) -> None:
    """Return once a viewer listens at `port`; IncompleteError if it ends before, or takes for ever."""
    deadline = time.monotonic() + _PATIENCE
    while _is_free(port):
        if viewer.poll() is not None:
            raise _failed(viewer.returncode)
        if time.monotonic() > deadline:
            raise IncompleteError(f"the viewer does not listen at port {port} after {_PATIENCE:.0f} s.")
        time.sleep(0.05)


def _wait(viewer: subprocess.Popen[bytes]) -> None:
    code = viewer.wait()
    if code:
        raise _failed(code)


def _failed(code: int) -> IncompleteError:
    return IncompleteError(f"the viewer has failed (exit code {code}); what it said is above.")


def _is_free(port: int) -> bool:
    """Return whether nothing listens at a port."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((HOST, port)) != 0


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as held:
        # All of them at once, or the second might be the first again.
        probes = [held.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind((HOST, 0))
        return [int(probe.getsockname()[1]) for probe in probes]


@contextlib.contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Let a SIGTERM end what a Ctrl-C ends, so that no viewer is left behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
