"""`robosim view`: open a recording in the viewer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from robosim.cli.program import hint


@dataclass(frozen=True)
class View:
    """Open a recording in the rerun viewer, or in a browser."""

    recording: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="FILE.rrd")] = None
    """The recording."""
    web: bool = False
    """Serve it to a browser on this machine; so it is, too, where there is no display for a window."""
    port: int | None = None
    """Where the browser finds it, with its data at the next port; by default 9090, or what is free."""

    def run(self) -> None:
        """Open it, and wait until the viewer is closed."""
        from robosim.errors import InputError, whole_number

        if self.recording is None:
            raise InputError(f"view needs a recording: {_which()}")
        from robosim.playback.file import require_whole_recording
        from robosim.playback.viewer import has_display, show

        if self.port is not None:
            whole_number("--port", self.port, 1, 65534)
            if not self.web and has_display():
                raise InputError("--port says where a browser finds the recording: it needs --web.")
        require_whole_recording(self.recording)
        show(self.recording, web=self.web, port=self.port, say=say)


def _which() -> str:
    """Return the end of a sentence that says which recording might be meant, or how to make one."""
    here = [path for path in Path().glob("*.rrd") if path.is_file()]
    if here:
        latest = max(here, key=lambda path: path.stat().st_mtime)
        return f"the latest here is opened by `{hint('view', latest)}`."
    return f"`{hint('play', 'paper-8', '--save', 'run.rrd')}` makes one."


def say(sentence: str) -> None:
    """Print a line at once: a person waits for it."""
    print(sentence, flush=True)
