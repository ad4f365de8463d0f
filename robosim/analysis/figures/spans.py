"""Which part of an episode a space-time diagram shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from robosim.analysis.clogs.clog import Clog
from robosim.analysis.measure.metrics import clogs
from robosim.analysis.measure.monitor import Episode

_SPANS = (120.0, 180.0, 240.0, 300.0)
"""Lengths that a strip may have, s; in longer ones, crossings can no longer be seen apart."""
_STRIPS = 5
"""A page has so many strips of one panel, or fewer of several."""
_PANELS = 12
"""The most panels on a page."""
_BEFORE, _AFTER, _BEGINNING = 45.0, 45.0, 75.0
"""Time shown before a clog, after it, and of its beginning and end when it is long, s."""


class Span(NamedTuple):
    """A stretch of time, s."""

    begin: float
    end: float


def longest_clog(episodes: Sequence[Episode]) -> tuple[int, Clog | None]:
    """Return the episode with the clog that lasted longest, and the clog; the first one and None without."""
    found = [(clog.end - clog.start, -number) for number, one in enumerate(episodes) for clog in clogs(one)]
    if not found:
        return 0, None
    number = -max(found)[1]
    return number, max(clogs(episodes[number]), key=lambda clog: clog.end - clog.start)


def strips(episode: Episode, clog: Clog | None) -> list[Span]:
    """Cut an episode in strips of equal length; of a long one, take the part around `clog`."""
    total = max(episode.seconds, 1e-9)
    if total <= _SPANS[0]:
        return [Span(0.0, total)]
    most = max(1, min(_STRIPS, _PANELS // max(1, episode.tunnels.count)))
    length = next((span for span in _SPANS if most * span >= total), _SPANS[-1])
    of_all = math.ceil(total / length - 1e-9)
    count, first = min(most, of_all), 0
    if clog is not None:
        at = int(clog.start * episode.arena.timing.decision_period // length)
        first = max(0, min(at - count // 3, of_all - count))
    return [Span(row * length, (row + 1) * length) for row in range(first, first + count)]


def around(clog: Clog, episode: Episode) -> list[Span]:
    """Return the time to show of a clog: all of it, or its beginning and its end."""
    period = episode.arena.timing.decision_period
    begin, end = _first_of(clog, clogs(episode)).start * period, clog.end * period
    first, last = max(0.0, begin - _BEFORE), min(episode.seconds, end + _AFTER)
    if last - first <= 2.0 * (_BEFORE + _BEGINNING):
        return [Span(first, last)]
    return [Span(first, begin + _BEGINNING), Span(end - _BEGINNING, last)]


def _first_of(clog: Clog, found: Sequence[Clog]) -> Clog:
    """Return the first piece of a stay that passages have cut in pieces, of which `clog` is one."""
    for one in sorted(found, key=lambda one: -one.start):
        if one.end == clog.start and one.tunnel == clog.tunnel and set(one.members) & set(clog.members):
            clog = one
    return clog
