"""Starts a whole team on one machine: the world, the pheromone service, and a process for each robot."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

WORLD, PHEROMONES = "world", "pheromones"
_TO_END = 5.0
"""s that a process is given to end in order."""


def free_addresses(count: int) -> list[str]:
    """Return addresses on this machine at which nobody listens just now, HOST:PORT."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [f"127.0.0.1:{one.getsockname()[1]}" for one in sockets]


class TeamOfProcesses:
    """The processes of a team, by name: `world`, `pheromones`, `robot-0` and so on.

    Each writes what it says to `NAME.log` in a folder. To be used in a `with`: what still runs at its end is
    asked to end, and then killed.
    """

    def __init__(self, policy: str, robots: int, folder: Path, options: Sequence[str] = ()) -> None:
        """`options` are given to all of them; addresses are chosen where nobody listens."""
        world_at, map_at = free_addresses(2)
        self._policy = policy
        self.robots = robots
        self.folder = folder
        self.common = [
            *("--robots", str(robots)),
            *("--world-at", world_at),
            *("--map-at", map_at),
            *options,
        ]
        """Options of all processes, with which others may join."""
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    def start(self, name: str, options: Sequence[str] = ()) -> subprocess.Popen[bytes]:
        """Start a process by its name; what was said under that name before is kept."""
        what = ["robot", "--robot", name.removeprefix("robot-")] if name.startswith("robot-") else [name]
        command = [sys.executable, "-m", "robosim", "deploy", *what, self._policy, *self.common, *options]
        with (self.folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)  # noqa: S603  # our own
        self.running[name] = process
        return process

    def start_all(self, world: Sequence[str] = (), others: Sequence[str] = ()) -> None:
        """Start everybody; `world` are options of the world, `others` of all but it."""
        self.start(WORLD, world)
        self.start(PHEROMONES, others)
        for robot in range(self.robots):
            self.start(f"robot-{robot}", others)

    def kill(self, name: str) -> None:
        """End a process as a power cut does."""
        self.running[name].kill()
        self.running[name].wait()

    def wait(self, name: str, timeout: float) -> int:
        """Return the exit code of a process; subprocess.TimeoutExpired if it has none by then."""
        return self.running[name].wait(timeout)

    def log(self, name: str) -> str:
        """Return what a process has said so far."""
        path = self.folder / f"{name}.log"
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""

    def lines(self) -> Iterator[str]:
        """Yield the lines of all logs, by name."""
        for path in sorted(self.folder.glob("*.log")):
            yield from path.read_text(encoding="utf-8", errors="replace").splitlines()

    def wait_for(self, name: str, text: str, timeout: float) -> bool:
        """Wait until a process has said `text`; return whether it has."""
        limit = time.monotonic() + timeout
        while text not in self.log(name):
            if time.monotonic() > limit or self.running[name].poll() is not None:
                return text in self.log(name)
            time.sleep(0.05)
        return True

    def end(self) -> None:
        """End what still runs, in order where it does so in time."""
        for process in self.running.values():
            if process.poll() is None:
                process.terminate()
        limit = time.monotonic() + _TO_END
        for process in self.running.values():
            try:
                process.wait(max(limit - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
