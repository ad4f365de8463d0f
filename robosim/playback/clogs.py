"""Clogs for a recording: who stands in one after each decision, said once it is known to be one.

Whether robots that stand are in a clog shows only when they have stood for long. So rows wait here until
that is decided of everybody who stands, and leave in order. It takes no longer than a clog must last, so the
memory is the same however long the run is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.analysis.clogs.clog import TRANSITS, Clog, clogs_among
from robosim.analysis.clogs.finder import ClogFinder
from robosim.analysis.clogs.groups import hold_decisions
from robosim.analysis.measure.tunnels import Tunnels, find_tunnels
from robosim.analysis.measure.visits import VisitLog
from robosim.arena.model import Arena
from robosim.episodes.columns import FrameColumns
from robosim.episodes.frame import Frame
from robosim.playback.lineages import Lineages, Piece

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

CHUNK = 1000
"""Decisions that are looked at together."""


class Drawn(NamedTuple):
    """Who stands in a clog after each of some decisions, in order."""

    step: Integers
    """[rows]."""
    place: Floats
    """[rows, robots, 2] m."""
    member: Bools
    """[rows, robots]."""
    link: Bools
    """[rows, robots, robots] which members are linked; symmetric, False on the diagonal."""


class NumberedClog(NamedTuple):
    """A clog that is over, or that the run has left standing."""

    number: int
    """From 1, in the order of their starts."""
    clog: Clog
    parts: list[tuple[int, int]]
    """The recorded decisions of it: each from a first one up to, not including, a last."""


class Settled(NamedTuple):
    """What is known for certain since the last time."""

    drawn: Drawn
    """Of the decisions that are recorded."""
    clogs: list[NumberedClog]
    until: int
    """The next decision."""


def decisions_until_certain(arena: Arena) -> int:
    """Return how many decisions after its start it is certain whether a standstill is a clog."""
    slowest = float(find_tunnels(arena).transit_time.max(initial=0.0))
    return hold_decisions(arena) + math.ceil(TRANSITS * slowest / arena.timing.decision_period)


class ClogWatch:
    """Takes the frames of a run, also those that are not recorded, and hands on what is to be drawn.

    `write` gets it, now and then. Where frames are left out, whatever stands is over, and all begins anew.
    """

    def __init__(self, arena: Arena, robots: int, write: Callable[[Settled], None]) -> None:
        self._arena = arena
        self._robots = robots
        self._tunnels = find_tunnels(arena)
        self._write = write
        self._columns = FrameColumns(robots, arena.pellets.count, (arena.rows, arena.columns), CHUNK)
        self._recorded = np.empty(CHUNK, dtype=np.bool_)
        self._stretch = _Stretch(arena, robots, self._tunnels)
        self._last_step = -1
        self._spans: list[tuple[int, int]] = []
        self._waiting: list[Clog] = []
        self._numbered = 0

    def add(self, frame: Frame, *, recorded: bool) -> None:
        """Take in the next frame."""
        if self._last_step >= 0 and frame.step != self._last_step + 1:
            self._hand_on(frame.step, over=True)
            self._stretch = _Stretch(self._arena, self._robots, self._tunnels)
        self._last_step = frame.step
        if recorded:
            self._extend_spans(frame.step)
        self._recorded[self._columns.rows] = recorded
        if self._columns.add(frame):
            self._hand_on(frame.step + 1, over=False)

    def settle(self) -> None:
        """Hand on what is certain by now."""
        self._hand_on(self._last_step + 1, over=False)

    def finish(self) -> None:
        """Hand on the rest."""
        self._hand_on(self._last_step + 1, over=True)

    def _extend_spans(self, step: int) -> None:
        if self._spans and self._spans[-1][1] == step:
            self._spans[-1] = self._spans[-1][0], step + 1
        else:
            self._spans.append((step, step + 1))

    def _hand_on(self, until: int, *, over: bool) -> None:
        if self._columns.rows:
            self._stretch.add(self._columns, self._recorded[: self._columns.rows])
            self._columns.clear()
        drawn, ended, earliest = self._stretch.decide(over=over)
        # Numbers go by the start, so that a clog waits for all that stand and began before it.
        waiting = sorted([*self._waiting, *ended], key=lambda clog: (clog.start, clog.end, clog.members))
        self._waiting = [clog for clog in waiting if clog.start >= earliest]
        decided = [
            NumberedClog(self._numbered + number, clog, self._parts(clog))
            for number, clog in enumerate(waiting[: len(waiting) - len(self._waiting)], 1)
        ]
        self._numbered += len(decided)
        earliest = min([earliest, *(clog.start for clog in self._waiting)])
        self._spans = [span for span in self._spans if span[1] > earliest or span is self._spans[-1]]
        self._write(Settled(drawn, decided, until))

    def _parts(self, clog: Clog) -> list[tuple[int, int]]:
        parts = ((max(start, clog.start), min(end, clog.end)) for start, end in self._spans)
        return [(start, end) for start, end in parts if start < end]


class _Window(NamedTuple):
    """Rows that wait."""

    step: Integers
    """[rows]."""
    place: Floats
    """[rows, robots, 2] m."""
    link: Bools
    """[rows, robots, robots] who is linked."""
    lineage: Integers
    """[rows, robots] which lineage of groups each is in, or -1."""
    recorded: Bools
    """[rows]."""


class _Stretch:
    """Frames without a gap between them."""

    def __init__(self, arena: Arena, robots: int, tunnels: Tunnels) -> None:
        self._robots = robots
        self._tunnels = tunnels
        self._hold = hold_decisions(arena)
        self._visits = VisitLog(tunnels)
        self._finder = ClogFinder(arena, robots, tunnels)
        self._lineages = Lineages(robots, self._hold)
        self._window = _Window(
            np.zeros(0, dtype=np.int64),
            np.zeros((0, robots, 2)),
            np.zeros((0, robots, robots), dtype=np.bool_),
            np.zeros((0, robots), dtype=np.int64),
            np.zeros(0, dtype=np.bool_),
        )
        self._ended: list[Clog] = []
        """Of these, not everything has been drawn."""

    def add(self, frames: FrameColumns, recorded: Bools) -> None:
        """Take in the next rows."""
        place = frames.pose[: frames.rows, :, :2]
        distance = self._tunnels.distance_to_home(place)
        step = frames.step[: frames.rows]
        rows, columns = self._tunnels.cells(place)
        ended = self._visits.add(step, self._tunnels.inside[rows, columns], distance)
        self._finder.add(frames, distance, ended)
        groups, window = self._finder.groups, self._window
        self._window = _Window(
            np.concatenate([window.step, step]),
            np.concatenate([window.place, place]),
            np.concatenate([window.link, groups.link]),
            np.concatenate([window.lineage, np.full_like(groups.label, -1)]),
            np.concatenate([window.recorded, recorded]),
        )
        self._lineages.follow(self._window.step, groups.label, self._window.lineage, self._window.link)

    def decide(self, *, over: bool) -> tuple[Drawn, list[Clog], int]:
        """Return what to draw, the clogs that have ended, and the first decision at which another may begin.

        Among those others are clogs that stand.
        """
        if over:
            self._finder.finish()
        ended = clogs_among(self._finder.found)
        self._finder.found.clear()
        self._ended += ended
        window = self._window
        now = int(window.step[-1]) + 1 if len(window.step) else 0
        # What is recognised next has begun by then.
        next_start = now if over else now - self._hold
        standing, sure = self._finder.standing(0.0), self._finder.standing()
        undecided = [start for start, members in standing if (start, members) not in sure]
        horizon = min([next_start, *undecided])
        present = [Piece(clog.start, clog.end, frozenset(clog.members)) for clog in self._ended]
        present += [Piece(start, now, members) for start, members in sure]
        drawn = self._draw(present, horizon)
        self._ended = [clog for clog in self._ended if clog.end > horizon]
        self._drop(horizon)
        return drawn, ended, min([next_start, *(start for start, _ in standing)])

    def _draw(self, clogs: Sequence[Piece], horizon: int) -> Drawn:
        """Return what is to be drawn of the rows before `horizon`."""
        window = self._window
        count = len(window.step)
        first = int(window.step[0]) if count else 0
        member = np.zeros((count, self._robots), dtype=np.bool_)
        link = np.zeros((count, self._robots, self._robots), dtype=np.bool_)
        for clog in clogs:
            rows = slice(max(clog.start - first, 0), max(clog.end - first, 0))
            mine = self._lineages.whose(window.lineage[rows], clog)
            member[rows] |= mine
            link[rows] |= window.link[rows] & mine[:, :, None] & mine[:, None, :]
        shown = window.recorded & (window.step < horizon)
        return Drawn(window.step[shown], window.place[shown], member[shown], link[shown])

    def _drop(self, horizon: int) -> None:
        window = self._window
        rows = int(np.searchsorted(window.step, horizon))
        self._lineages.forget(window.step, window.lineage, rows)
        self._window = _Window(
            window.step[rows:].copy(),
            window.place[rows:].copy(),
            window.link[rows:].copy(),
            window.lineage[rows:].copy(),
            window.recorded[rows:].copy(),
        )
