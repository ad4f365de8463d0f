"""A recording that can be watched while it is made."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from robosim.arena.model import Arena
from robosim.episodes.frame import Frame
from robosim.playback.recorder import recording

PORT = 9876
"""Of the viewer, where it listens for what it is to show."""
_EVERY = 0.5
"""s of the wall clock between two pictures that the viewer is shown."""


def has_display() -> bool:
    """Return whether a window can be opened here."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


@contextlib.contextmanager
def live_recording(
    path: Path,
    arena: Arena,
    *,
    robots: int,
    about: Mapping[str, str],
    view: bool,
    say: Callable[[str], None],
    port: int = PORT,
) -> Iterator[Callable[[Frame], None]]:
    """Give what records a frame to `path`; with `view` a viewer opens, and shows frames as they come.

    `say` is told where there is no display, and so only the file. Errors as of `recording`.
    """
    watched = view and has_display()
    if watched:
        # By module, since the viewer's command need not be on the path.
        viewer_command = [sys.executable, "-m", "rerun", "--port", str(port), "--hide-welcome-screen"]
        subprocess.Popen(viewer_command, start_new_session=True)  # noqa: S603  # our own interpreter
    elif view:
        say(f"there is no display for the viewer: only {path} is written")
    viewer = f"rerun+http://127.0.0.1:{port}/proxy" if watched else ""
    with recording(path, arena, robots=robots, about=about, viewer=viewer) as recorder:
        flushed = time.monotonic()

        def add(frame: Frame) -> None:
            nonlocal flushed
            recorder.add(frame)
            if watched and time.monotonic() - flushed >= _EVERY:
                recorder.flush()
                flushed = time.monotonic()

        yield add
