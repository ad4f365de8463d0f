"""Ctrl-C and SIGTERM during a run: held back until what is at work fits together again."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType


@contextlib.contextmanager
def hold_interrupts() -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C and SIGTERM back, and yield a function that says whether one came.

    A second one interrupts at once. Signals only reach the main thread; in another one this holds nothing
    back.
    """
    came: list[int] = []

    def take(number: int, _frame: FrameType | None) -> None:
        if came:
            raise KeyboardInterrupt
        came.append(number)

    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
