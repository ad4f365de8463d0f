"""`robosim deploy stop` and `release`: whoever may hold a team, and let it go on."""

from __future__ import annotations

import time
from collections.abc import Callable

from robosim.deploy.link.lines import Lines
from robosim.deploy.link.mail import Letter, Mail
from robosim.deploy.link.messages import MOST_ROBOTS, NOBODY, Clock, Order, Rest
from robosim.deploy.link.session import Link
from robosim.deploy.link.streams import Stream
from robosim.deploy.processes.times import GONE, HEARTBEAT
from robosim.errors import IncompleteError


class Operator:
    """Orders the world to hold the team, or to release it, and sees whether that was done."""

    def __init__(self, link: Link, lines: Lines) -> None:
        self._link, self._lines = link, lines
        self._mail = Mail(link, lines, MOST_ROBOTS)
        self._stream = Stream()
        self._clock: Clock | None = None
        link.hear("clock")

    def stop(self, reason: str, patience: float) -> int:
        """Hold all robots; returns how many, once all have been seen at rest.

        IncompleteError, in a sentence that names the robots, if some do not say so within `patience` s each
        for the world's answer and for theirs.
        """
        me = self._link.instance
        order = Order(reason=reason)
        clock = self._order(order, patience, lambda clock: clock.hold == me)
        if clock is None or clock.hold != me:
            raise IncompleteError(f"{self._unheard(clock, patience)}, so nobody was stopped by this.")
        limit = time.monotonic() + patience
        while any(one != Rest.STANDS for one in clock.rest) and time.monotonic() < limit:
            self._listen(HEARTBEAT)
            clock = self._clock or clock
        if faults := self._faults(clock):
            raise IncompleteError(
                f"the world holds all {len(clock.drivers)} robots, but {'; '.join(faults)}; "
                "all stay held until they are released."
            )
        return len(clock.drivers)

    def release(self, patience: float) -> bool:
        """End the emergency stop that holds the team; returns whether one did.

        IncompleteError if it stays, or no world is heard within `patience` s.
        """
        limit = time.monotonic() + patience
        while self._clock is None and time.monotonic() < limit:
            self._listen(HEARTBEAT)
        if self._clock is None:
            raise IncompleteError(f"{self._unheard(None, patience)}, so nobody was released.")
        hold = self._clock.hold
        if hold == NOBODY:
            return False
        clock = self._order(Order(release=hold), patience, lambda clock: clock.hold != hold)
        if clock is None or clock.hold != NOBODY:
            raise IncompleteError(
                "the team is still held: the world has not released it, or was told to hold anew."
            )
        return True

    def _order(self, order: Order, patience: float, heard: Callable[[Clock], bool]) -> Clock | None:
        """Send an order until the clock shows that it was heard, or time is up; return the newest clock."""
        limit = time.monotonic() + patience
        while time.monotonic() < limit and not (self._clock and heard(self._clock)):
            self._link.send("order", order)
            self._listen(HEARTBEAT)
        return self._clock

    def _listen(self, seconds: float) -> None:
        for item in self._mail.take(seconds):
            if not isinstance(item, Letter) or not isinstance(item.message, Clock):
                continue
            if self._stream.silent(item.at) > GONE:
                self._stream.bind(item.header.instance)
            if not self._stream.admit(item.header, item.at):
                self._clock = item.message

    def _unheard(self, clock: Clock | None, patience: float) -> str:
        what = "no world is heard" if clock is None else "the world does not obey"
        return f"{what}, after {patience:g} s"

    def _faults(self, clock: Clock) -> list[str]:
        said = {
            Rest.UNKNOWN: "has not said that it holds",
            Rest.HOLDS: "has not been seen at rest yet",
            Rest.MOVES: "could not stop: it still moves, or is not seen",
        }
        return [
            f"robot {robot} {said[rest] if driver != NOBODY else 'has no process'}"
            for robot, (rest, driver) in enumerate(zip(clock.rest, clock.drivers, strict=True))
            if rest != Rest.STANDS
        ]
