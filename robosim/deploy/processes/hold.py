"""The emergency stop of a team: who ordered it, who may end it, and what stays when the world does not."""

from __future__ import annotations

from collections import deque

from robosim.deploy.link.messages import NOBODY, Order

OVER = "of an emergency stop that is over"
ANOTHER = "releases another emergency stop than the one that holds"
MOST_REMEMBERED = 1000
"""Emergency stops that are over, whose late messages are known by that."""
UNNAMED = "no reason given"


class TeamHold:
    """The world's part: takes orders, and takes over an emergency stop that robots bring from an earlier run.

    An emergency stop goes by the instance of whoever ordered it, and is ended by that number alone. So an
    order that is doubled, or comes late, neither ends a newer stop nor begins an old one anew.
    """

    def __init__(self) -> None:
        self.hold = NOBODY
        """The one that holds."""
        self.released = NOBODY
        """The last that was ended by an order."""
        self.reason = ""
        self._over: deque[int] = deque(maxlen=MOST_REMEMBERED)

    def take(self, sender: int, order: Order) -> tuple[str, str]:
        """Obey an order; returns why it is dropped, and what is new, in words, or nothing of either."""
        if order.release != NOBODY:
            return self._release(order.release)
        if sender in self._over:
            return OVER, ""
        if sender == self.hold:
            return "", ""
        self._begin(sender, order.reason or UNNAMED)
        return "", f"emergency stop: {self.reason}; holds all robots"

    def heard(self, robot: int, hold: int) -> str:
        """Take note of what holds a robot; returns what is new, in words, or nothing.

        A robot that is held by a stop which nobody has released comes from an earlier run of the world: then
        all are held again.
        """
        if hold in (NOBODY, self.hold) or hold in self._over or self.hold != NOBODY:
            return ""
        self._begin(hold, "of an earlier run")
        return f"robot {robot} comes held by an emergency stop of an earlier run; holds all robots"

    def _begin(self, hold: int, reason: str) -> None:
        if self.hold != NOBODY:
            self._over.append(self.hold)
        self.hold, self.reason = hold, reason

    def _release(self, which: int) -> tuple[str, str]:
        if which == self.released and self.hold == NOBODY:
            return "", ""
        if which != self.hold:
            return ANOTHER, ""
        self._over.append(which)
        self.hold, self.released, self.reason = NOBODY, which, ""
        return "", "the emergency stop is released; robots go on"


class RobotHold:
    """A robot's part: it stays held until the very stop that holds it is released, in whatever world."""

    def __init__(self) -> None:
        self.hold = NOBODY
        """The one that holds this robot."""

    def take(self, hold: int, released: int) -> bool | None:
        """Follow the clock; return True where the robot is held anew, False where released."""
        if hold not in (NOBODY, self.hold):
            self.hold = hold
            return True
        if hold == NOBODY and self.hold != NOBODY and released == self.hold:
            self.hold = NOBODY
            return False
        return None
