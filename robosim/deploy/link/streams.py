"""What a receiver believes of the messages on one key: whose they are, in which order, and how old.

Clocks of two machines are never compared. A message's age is the time since it arrived, on the receiver's
own monotonic clock, and by how much it took longer than the quickest of late: that is seen from how the
difference of the two clocks changes, whatever they show.
"""

from __future__ import annotations

import math

from robosim.deploy.link.messages import NOBODY, Header

_WINDOW = 30.0
"""s; for so long at least the quickest message counts, since clocks drift against each other."""
SAME, OLDER, FOREIGN = "sent twice", "overtaken by a newer one", "from another process"


class Stream:
    """The messages of one process on one key."""

    def __init__(self) -> None:
        self.instance = NOBODY
        """Of the process that is believed; `NOBODY` while there is none."""
        self.lost = 0
        """Messages that have not come, or not yet."""
        self._sequence = 0
        self._received = -math.inf
        self._late = 0.0
        self._quickest = math.inf
        self._quickest_before = math.inf
        self._window_began = -math.inf

    def bind(self, instance: int) -> None:
        """Believe this process from now on, and no other."""
        if instance != self.instance:
            self.__init__()  # type: ignore[misc]
            self.instance = instance

    def admit(self, header: Header, now: float) -> str:
        """Return why a message that arrived at `now` (s, monotonic) is dropped; empty if it is taken."""
        if header.instance != self.instance:
            return FOREIGN
        if header.sequence <= self._sequence:
            return SAME if header.sequence == self._sequence else OLDER
        # Of what was sent before this process listened nothing is known.
        self.lost += header.sequence - self._sequence - 1 if self._sequence else 0
        self._sequence = header.sequence
        self._received = now
        took = now - header.sent
        if now - self._window_began > _WINDOW:
            self._quickest_before, self._quickest = self._quickest, math.inf
            self._window_began = now
        self._quickest = min(self._quickest, took)
        self._late = took - min(self._quickest, self._quickest_before)
        return ""

    def age(self, now: float) -> float:
        """Return how old the newest message is at `now`, s; infinite without one."""
        return now - self._received + self._late

    def silent(self, now: float) -> float:
        """Return how long ago the newest message arrived, s; infinite without one."""
        return now - self._received
