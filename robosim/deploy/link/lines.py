"""What a process of a deployed team says: plain lines with the time and the reason."""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from typing import TextIO

EVERY = 5.0
"""s: what is counted is said so often at most."""
_LONGEST_KEY = 100
"""Characters."""


class Lines:
    """Writes lines for people to a stream, each with the time and who says it."""

    def __init__(self, who: str, stream: TextIO | None = None) -> None:
        self._who = who
        self._stream = sys.stderr if stream is None else stream
        self.dropped: dict[str, int] = {}
        """How many messages were dropped, for each reason."""
        self._told: dict[str, tuple[float, int]] = {}

    def say(self, text: str) -> None:
        """Write a line; whoever no longer reads it must not stop the process."""
        now = datetime.now(UTC).strftime("%H:%M:%S.%f")[:-3]
        try:
            print(f"{now} {self._who}: {text}", file=self._stream, flush=True)
        except (OSError, ValueError):
            self._stream = _Nowhere()

    def drop(self, key: str, reason: str) -> None:
        """Count a message that is dropped, and say so now and then."""
        # Keys come from strangers: they must not steer a terminal, nor their number fill memory.
        plain = key.isprintable() and len(key) <= _LONGEST_KEY
        what = f"{key if plain else 'a strange key'}: {reason}"
        if what not in self.dropped and len(self.dropped) >= 1000:
            what = "other keys"
        count = self.dropped[what] = self.dropped.get(what, 0) + 1
        at, told = self._told.get(what, (-EVERY, 0))
        now = time.monotonic()
        if now - at >= EVERY:
            self._told[what] = now, count
            self.say(f"dropped {count - told} message{'s' if count - told > 1 else ''} on {what}")

    def sum_up(self) -> None:
        """Say how much was dropped in all."""
        for what, count in sorted(self.dropped.items()):
            self.say(f"dropped in all: {count} on {what}")


class _Nowhere:
    def write(self, text: str) -> int:
        return len(text)

    def flush(self) -> None:
        """Nothing waits."""
