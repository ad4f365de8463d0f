"""A recording that can be watched while it is made."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from robosim.arena.model import Arena
from robosim.episodes.frame import Frame
from robosim.playback.recorder import recording
from robosim.playback.viewer import has_display, live_viewer


@contextlib.contextmanager
def live_recording(
    path: Path,
    arena: Arena,
    *,
    robots: int,
    about: Mapping[str, str],
    view: bool,
    say: Callable[[str], None],
    rewards: bool = True,
) -> Iterator[Callable[[Frame], None]]:
    """Give what records a frame to `path`; with `view` a viewer opens, and shows frames as they come.

    `say` is told where there is no display, and so only the file. `rewards` and errors as of `recording`.
    """
    with contextlib.ExitStack() as stack:
        viewer = ""
        if view and has_display():
            viewer = stack.enter_context(live_viewer(say, lingers=False))
        elif view:
            say(f"there is no display for the viewer: only {path} is written")
        kept = recording(path, arena, robots=robots, about=about, viewer=viewer, rewards=rewards)
        yield stack.enter_context(kept).add
