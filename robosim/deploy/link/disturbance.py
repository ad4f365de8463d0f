"""A bad link, on purpose: messages of a process lost, doubled, late and out of order, to try a team on."""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable

import numpy as np
from pydantic import Field

from robosim.records import Record


class Disturbance(Record):
    """What happens to the messages that a process sends."""

    loss: float = Field(default=0.0, ge=0, le=1)
    """Probability that a message gets lost."""
    doubled: float = Field(default=0.0, ge=0, le=1)
    """Probability that a message arrives twice."""
    delay: float = Field(default=0.0, ge=0, le=60)
    """Time that every message takes, s of the wall clock."""
    jitter: float = Field(default=0.0, ge=0, le=60)
    """Further time that each takes, drawn evenly from 0 to this, s: the later ones overtake."""
    disturbance_seed: int = Field(default=0, ge=0, le=2**63)
    """Of what is drawn, with the name of the process: those of a team lose messages independently."""

    @property
    def quiet(self) -> bool:
        """Whether nothing happens to any message."""
        return not (self.loss or self.doubled or self.delay or self.jitter)


class Disturber:
    """Stands between the process of that name and its link."""

    def __init__(self, name: str, disturbance: Disturbance, send: Callable[[str, bytes], None]) -> None:
        self._disturbance = disturbance
        self._send = send
        self._rng = np.random.default_rng((disturbance.disturbance_seed, *name.encode()))
        self._waiting: list[tuple[float, int, str, bytes]] = []
        self._count = 0
        self._changed = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._deliver, name="disturber", daemon=True)
        self._thread.start()

    def put(self, key: str, data: bytes) -> None:
        """Send a message as the disturbance will have it."""
        what = self._disturbance
        copies = 0 if self._rng.random() < what.loss else 1 + int(self._rng.random() < what.doubled)
        now = time.monotonic()
        with self._changed:
            for _ in range(copies):
                due = now + what.delay + what.jitter * self._rng.random()
                self._count += 1
                heapq.heappush(self._waiting, (due, self._count, key, data))
            self._changed.notify()

    def close(self) -> None:
        """End; what is under way is lost."""
        with self._changed:
            self._open = False
            self._changed.notify()
        self._thread.join()

    def _deliver(self) -> None:
        while True:
            with self._changed:
                while self._open and not (self._waiting and self._waiting[0][0] <= time.monotonic()):
                    wait = self._waiting[0][0] - time.monotonic() if self._waiting else None
                    self._changed.wait(wait)
                if not self._open:
                    return
                _, _, key, data = heapq.heappop(self._waiting)
            self._send(key, data)
