"""Groups followed through time, to say after each decision which robots belong to which clog."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

_EVER = 2**62


class Piece(NamedTuple):
    """A clog that is over, or as far as it has come."""

    start: int
    end: int
    """First decision after which it is over, or the next one."""
    members: frozenset[int]


class Threads:
    """Follows groups: two of them are of one thread if a robot was in both, also with a pause in between.

    Threads that grow together stay apart before that, since a clog may be over by then.
    """

    def __init__(self, robots: int, hold: int) -> None:
        self._hold = hold
        self._count = 0
        self._into: dict[int, tuple[int, int]] = {}
        """What a thread became as it grew together with an older one, and the decision."""
        self._thread = np.full(robots, -1)
        """[robots] the latest thread of each."""
        self._last = np.full(robots, -hold - 1)
        """[robots] the last decision in it."""
        self._seen: dict[int, Integers] = {}
        """By thread: [robots] the last decision of each in it, of the rows that are forgotten, or -1."""

    def follow(self, step: Integers, label: Integers, thread: Integers, link: Bools) -> None:
        """Write into `thread` [rows, robots] who is in which, or -1, after the decisions `step` [rows].

        The last of them are new, and have the groups `label`. They change also the ones before: robots that
        were in a pause until now are in it, and those of a new thread are in it and linked for the `hold`
        decisions in which they had come to a halt.
        """
        old = len(step) - len(label)
        changes = (np.flatnonzero((label[1:] != label[:-1]).any(axis=1)) + 1).tolist()
        for first, end in zip([0, *changes], [*changes, len(label)], strict=True):
            standing, now = label[first], int(step[old + first])
            for one in np.unique(standing[standing >= 0]).tolist():
                group = np.flatnonzero(standing == one)
                recent = group[now - self._last[group] <= self._hold]
                rows = slice(old + first, old + end)
                if len(recent) == 0:
                    begin = max(0, rows.start - self._hold)
                    members = np.ix_(group, group)
                    link[begin : rows.start, members[0], members[1]] = link[rows.start][members]
                    rows = slice(begin, rows.stop)
                for robot in recent.tolist():
                    gap = slice(old + first - (now - int(self._last[robot])) + 1, old + first)
                    thread[gap, robot] = self._thread[robot]
                thread[rows, group] = self._thread[group] = self._join(self._thread[recent].tolist(), now)
                self._last[group] = int(step[old + end - 1])

    def _join(self, threads: Sequence[int], step: int) -> int:
        """Make one thread of several, or a new one of none."""
        roots = {self._root(thread, step) for thread in threads}
        if not roots:
            self._count += 1
            return self._count - 1
        root = min(roots)
        self._into.update(dict.fromkeys(roots - {root}, (root, step)))
        return root

    def _root(self, thread: int, end: int) -> int:
        """Return what a thread has become by the decision `end`."""
        while thread in self._into and self._into[thread][1] <= end:
            thread = self._into[thread][0]
        return thread

    def whose(self, thread: Integers, clog: Piece) -> Bools:
        """Return which robots are in a clog, in its rows [rows, robots] of threads.

        Its thread is the one whose robots since its start fit its members best.
        """
        there: dict[int, Bools] = {}
        for one in np.unique(thread[thread >= 0]).tolist():
            root = self._root(one, clog.end)
            there[root] = there.get(root, np.zeros_like(thread, dtype=np.bool_)) | (thread == one)
        best, fit = np.zeros_like(thread, dtype=np.bool_), 0.0
        for root, mine in there.items():
            seen = mine.any(axis=0)
            for one, last in self._seen.items():
                if self._root(one, clog.end) == root:
                    seen |= last >= clog.start
            robots = set(np.flatnonzero(seen).tolist())
            share = len(robots & clog.members) / len(robots | clog.members)
            if share > fit:
                best, fit = mine, share
        return best & np.isin(np.arange(thread.shape[1]), list(clog.members))

    def forget(self, step: Integers, thread: Integers, rows: int) -> None:
        """Forget the first `rows` rows, but for what `whose` needs of them for the others."""
        for one in np.unique(thread[:rows][thread[:rows] >= 0]).tolist():
            last = np.where(thread[:rows] == one, step[:rows, None], -1).max(axis=0)
            self._seen[one] = np.maximum(last, self._seen.get(one, -1))
        # What grew together before the rows that are left is one for good.
        first = int(step[rows]) if rows < len(step) else _EVER
        for one, (root, when) in sorted(self._into.items(), key=lambda item: item[1][1]):
            if when < first:
                del self._into[one]
                self._thread[self._thread == one] = root
                if one in self._seen:
                    self._seen[root] = np.maximum(self._seen.pop(one), self._seen.get(root, -1))
        live = {self._root(one, _EVER) for one in np.unique(thread[rows:]).tolist()}
        self._seen = {one: last for one, last in self._seen.items() if self._root(one, _EVER) in live}
