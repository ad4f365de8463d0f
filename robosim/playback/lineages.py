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


class Lineages:
    """Follows groups: two of them are of one lineage if a robot was in both, also with a pause in between.

    Lineages that grow together stay apart before that, since a clog may be over by then.
    """

    def __init__(self, robots: int, hold: int) -> None:
        self._hold = hold
        self._count = 0
        self._into: dict[int, tuple[int, int]] = {}
        """What a lineage became as it grew together with an older one, and the decision."""
        self._lineage = np.full(robots, -1)
        """[robots] the latest lineage of each."""
        self._last = np.full(robots, -hold - 1)
        """[robots] the last decision in it."""
        self._seen: dict[int, Integers] = {}
        """By lineage: [robots] the last decision of each in it, of the rows that are forgotten, or -1."""

    def follow(self, step: Integers, label: Integers, lineage: Integers, link: Bools) -> None:
        """Write into `lineage` [rows, robots] who is in which, or -1, after the decisions `step` [rows].

        The last of them are new, and have the groups `label`. They change also the ones before: robots that
        were in a pause until now are in it, and those of a new lineage are in it and linked for the `hold`
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
                    lineage[gap, robot] = self._lineage[robot]
                lineage[rows, group] = self._lineage[group] = self._join(self._lineage[recent].tolist(), now)
                self._last[group] = int(step[old + end - 1])

    def _join(self, lineages: Sequence[int], step: int) -> int:
        """Make one lineage of several, or a new one of none."""
        roots = {self._root(lineage, step) for lineage in lineages}
        if not roots:
            self._count += 1
            return self._count - 1
        root = min(roots)
        self._into.update(dict.fromkeys(roots - {root}, (root, step)))
        return root

    def _root(self, lineage: int, end: int) -> int:
        """Return what a lineage has become by the decision `end`."""
        while lineage in self._into and self._into[lineage][1] <= end:
            lineage = self._into[lineage][0]
        return lineage

    def whose(self, lineage: Integers, clog: Piece) -> Bools:
        """Return which robots are in a clog, in its rows [rows, robots] of lineages.

        Its lineage is the one whose robots since its start fit its members best.
        """
        there: dict[int, Bools] = {}
        for one in np.unique(lineage[lineage >= 0]).tolist():
            root = self._root(one, clog.end)
            there[root] = there.get(root, np.zeros_like(lineage, dtype=np.bool_)) | (lineage == one)
        best, fit = np.zeros_like(lineage, dtype=np.bool_), 0.0
        for root, mine in there.items():
            seen = mine.any(axis=0)
            for one, last in self._seen.items():
                if self._root(one, clog.end) == root:
                    seen |= last >= clog.start
            robots = set(np.flatnonzero(seen).tolist())
            share = len(robots & clog.members) / len(robots | clog.members)
            if share > fit:
                best, fit = mine, share
        return best & np.isin(np.arange(lineage.shape[1]), list(clog.members))

    def forget(self, step: Integers, lineage: Integers, rows: int) -> None:
        """Forget the first `rows` rows, but for what `whose` needs of them for the others."""
        for one in np.unique(lineage[:rows][lineage[:rows] >= 0]).tolist():
            last = np.where(lineage[:rows] == one, step[:rows, None], -1).max(axis=0)
            self._seen[one] = np.maximum(last, self._seen.get(one, -1))
        # What grew together before the rows that are left is one for good.
        first = int(step[rows]) if rows < len(step) else _EVER
        for one, (root, when) in sorted(self._into.items(), key=lambda item: item[1][1]):
            if when < first:
                del self._into[one]
                self._lineage[self._lineage == one] = root
                if one in self._seen:
                    self._seen[root] = np.maximum(self._seen.pop(one), self._seen.get(root, -1))
        live = {self._root(one, _EVER) for one in np.unique(lineage[rows:]).tolist()}
        self._seen = {one: last for one, last in self._seen.items() if self._root(one, _EVER) in live}
