"""A process's end of the link: a Zenoh session, and what has arrived by it.

Zenoh calls back in threads of its own, which must neither block nor call Zenoh: they only put what has come
into a bounded queue, and the process's own loop takes it out.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections import deque
from types import TracebackType
from typing import Any, NamedTuple, Self

import zenoh

from robosim.deploy.link.access import LinkConfig, settings_table
from robosim.deploy.link.disturbance import Disturbance, Disturber
from robosim.deploy.link.messages import MOST_BYTES, Message, pack
from robosim.errors import InputError

MOST_WAITING = 10_000
"""Messages in the queue; when more wait, the oldest go."""


class Arrived(NamedTuple):
    """Something that has come by the link."""

    key: str
    """Below the team's root."""
    data: bytes | None
    """None for a token."""
    size: int
    """Bytes of the message; more than `data` holds where it was too long to be taken."""
    at: float
    """On the monotonic clock, s."""
    there: bool
    """Of a token: whether it has come, or gone."""


class Link:
    """A session of one process; to be used in a `with`, or its threads keep the process from ending."""

    def __init__(
        self,
        name: str,
        config: LinkConfig,
        *,
        listen: str = "",
        connect: tuple[str, ...] = (),
        robots: int = 1,
        disturbance: Disturbance | None = None,
    ) -> None:
        """Open a session under a name of `robosim.deploy.link.access`.

        It listens at `listen` and connects to `connect` (HOST:PORT), now or as soon as somebody listens
        there, and again whenever a link breaks. InputError where it cannot listen, or lacks keys.
        """
        self.instance = secrets.randbits(63) | 1
        """Drawn anew by each process: two of one name are told apart by it."""
        self._root = config.root
        self._waiting: deque[Arrived] = deque(maxlen=MOST_WAITING)
        self._came = threading.Condition()
        self.overflowed = 0
        """Messages that were too many to wait."""
        table = settings_table(name, config, listen, connect, robots)
        try:
            self._session = zenoh.open(_settings(table))
        except zenoh.ZError as error:
            raise InputError(
                f"the link cannot be opened{f' at {listen}' if listen else ''}: {_short(error)}."
            ) from None
        self._publishers: dict[str, Any] = {}
        self._sequences: dict[str, int] = {}
        self._declared: list[Any] = []
        disturbed = disturbance is not None and not disturbance.quiet
        self._disturber = Disturber(name, disturbance, self._put) if disturbance and disturbed else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the session."""
        if self._disturber is not None:
            self._disturber.close()
        self._session.close()  # type: ignore[no-untyped-call]

    def send(self, key: str, message: Message, robot: int = 0) -> None:
        """Send a message on `key`; it is dropped rather than waited for when the link is congested."""
        sequence = self._sequences[key] = self._sequences.get(key, 0) + 1
        self.send_raw(key, pack(message, robot, self.instance, sequence, time.monotonic()))

    def send_raw(self, key: str, data: bytes) -> None:
        """Send bytes as they are."""
        if self._disturber is None:
            self._put(key, data)
        else:
            self._disturber.put(key, data)

    def hear(self, key: str) -> None:
        """Take in what is sent on `key`, which may hold wildcards, from now on."""
        self._declared.append(self._session.declare_subscriber(f"{self._root}/{key}", self._take_sample))

    def appear(self, key: str) -> None:
        """Show a token under `key`, which goes when this process does, however it ends."""
        self._declared.append(self._session.liveliness().declare_token(f"{self._root}/{key}"))

    def watch(self, key: str) -> None:
        """Take in which tokens there are under `key`, and how they come and go."""
        tokens = self._session.liveliness()
        self._declared.append(
            tokens.declare_subscriber(f"{self._root}/{key}", self._take_token, history=True)
        )

    def take(self, timeout: float) -> list[Arrived]:
        """Return all that has arrived, in order; waits up to `timeout` s if nothing has."""
        with self._came:
            if not self._waiting and timeout > 0.0:
                self._came.wait(timeout)
            arrived = list(self._waiting)
            self._waiting.clear()
        return arrived

    def _put(self, key: str, data: bytes) -> None:
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._session.declare_publisher(
                f"{self._root}/{key}",
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
        publisher.put(data)

    def _take_sample(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        data = bytes(sample.payload) if size <= MOST_BYTES else b""
        self._enqueue(Arrived(self._key(sample), data, size, time.monotonic(), there=True))

    def _take_token(self, sample: zenoh.Sample) -> None:
        there = sample.kind == zenoh.SampleKind.PUT
        self._enqueue(Arrived(self._key(sample), None, 0, time.monotonic(), there))

    def _key(self, sample: zenoh.Sample) -> str:
        return str(sample.key_expr).removeprefix(f"{self._root}/")

    def _enqueue(self, arrived: Arrived) -> None:
        with self._came:
            self.overflowed += len(self._waiting) == MOST_WAITING
            self._waiting.append(arrived)
            self._came.notify()


def _settings(table: dict[str, Any]) -> zenoh.Config:
    settings = zenoh.Config()
    for key, value in table.items():
        settings.insert_json5(key, json.dumps(value))
    return settings


def _short(error: Exception) -> str:
    """Return the first reason of Zenoh's long account of an error."""
    text = " ".join(str(error).split())
    return text.split(" at ")[0].rstrip(".")[:200]
