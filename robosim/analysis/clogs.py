"""Clogs: robots that want to move and cannot, linked by contact, while nobody gets through a tunnel.

The definition, in full:

- A robot is *held up* after a decision if within the last `HOLD` seconds it was told to move in at least
  half of the decisions, was in touch with something, and has come less than half its length far.
- Held-up robots are *linked* if within that time they touched each other, or the same loose pellet at once.
  What a robot holds is a part of it.
- Linked robots are a *group* if one of them is in a tunnel or its mouth (within a robot's length of it), and
  they are at least two, or one that touched a loose pellet. Groups that share a robot are the same in
  time, also over a pause shorter than `HOLD`.
- A group's stay is cut where a robot completes a passage of the tunnel: came in at one end, left at the
  other. A piece that lasts longer than k free-flow transit times of the tunnel is a *clog*. It begins
  when its robots came to a halt, `HOLD` before they were recognised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.analysis.groups import GroupFinder, Groups
from robosim.analysis.traffic import Visit
from robosim.analysis.tunnels import Tunnels
from robosim.arena.model import Arena
from robosim.envs.columns import FrameColumns

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

TRANSITS = 2.0
"""Clogs last longer than this many free-flow transit times (k)."""
SHORTEST = 0.5
"""Pieces from this many transit times on are kept, so that k can be varied afterwards."""
ACROSS = 0.5
"""A robot stands across the tunnel when the cosine between its heading and the axis is smaller."""
ABREAST = 0.25
"""Robots nearer to each other than this along the tunnel have neither passed nor yet to pass, in lengths."""


class Cause(Enum):
    """What stood in the way as a clog began; the first that holds."""

    HEAD_ON = "head-on"
    """Two linked robots are bound opposite ways and have yet to pass each other."""
    PELLET = "pellet in the way"
    """A member presses against a loose pellet."""
    TURNING = "turning"
    """A member stands across the tunnel."""
    QUEUE = "queue"
    """None of these: robots stand behind each other, and the first does not move on."""


class Ending(Enum):
    """What ended a clog."""

    PASSAGE = "somebody got through"
    """A robot completed a passage while the group still stood."""
    TOOK_PELLET = "pellet taken"
    """A member took a pellet as the group came apart."""
    BACKED_OFF = "one backed off"
    """The member that moved most went away from its goal."""
    WENT_ON = "one went on"
    """The member that moved most went toward its goal."""
    LET_GO = "no longer pressed"
    """Nobody moved away: the robots lost touch or no longer wanted to move."""
    RUN_ENDED = "run ended"
    """The clog outlasted the run."""


class Clog(NamedTuple):
    """One clog of one episode, or a standstill too short for one."""

    tunnel: int
    start: int
    """Decision after which its first members had come to a halt."""
    end: int
    """First decision after which it is over."""
    members: tuple[int, ...]
    """Every robot that was part of it, in order."""
    cause: Cause
    ending: Ending
    place: tuple[float, float]
    """Mean of the members' places as it was recognised, m."""
    distance: float
    """Mean of their distances to home, m."""
    transits: float
    """How long it lasted, in free-flow transit times of the tunnel."""


@dataclass(frozen=True, slots=True)
class _Onset:
    """How a piece of a stay began."""

    step: int
    cause: Cause
    place: tuple[float, float]
    distance: float


@dataclass(slots=True)
class _Stay:
    """A group in time, since it was recognised or last cut by a passage."""

    tunnel: int
    onset: _Onset
    members: set[int]
    now: set[int]
    """Its members when it was last seen to stand."""
    last: int
    """The decision after which that was."""
    distance: Floats
    """[robots] distances to home then, m."""
    laden: Bools
    """[robots] who was laden then."""


class _Chunk(NamedTuple):
    """The rows at hand."""

    frames: FrameColumns
    distance: Floats
    groups: Groups


class ClogFinder:
    """Takes chunks of frames and finds the clogs in them."""

    def __init__(self, arena: Arena, robots: int, tunnels: Tunnels) -> None:
        self._arena = arena
        self._tunnels = tunnels
        self._finder = GroupFinder(arena, robots, tunnels)
        self._stays: list[_Stay] = []
        self._visits_seen = 0
        self._last_step = 0
        self.groups = Groups(
            np.zeros((0, robots), dtype=np.int64),
            np.zeros((0, robots, robots), dtype=np.bool_),
            np.zeros((0, robots), dtype=np.bool_),
        )
        """Of the latest chunk."""
        self.found: list[Clog] = []
        """What has ended so far, standstills from `SHORTEST` transit times on; see `clogs_among`."""

    def add(self, frames: FrameColumns, distance: Floats, visits: Sequence[Visit]) -> None:
        """Take in the next rows, with distances to home [rows, robots] and all visits that have ended."""
        passages = [visit for visit in visits[self._visits_seen :] if visit.passage]
        self._visits_seen = len(visits)
        self.groups = self._finder.find(frames)
        chunk = _Chunk(frames, distance, self.groups)
        label, step = self.groups.label, frames.step[: frames.rows]
        changes = (np.flatnonzero((label[1:] != label[:-1]).any(axis=1)) + 1).tolist()
        for first, end in zip([0, *changes], [*changes, len(label)], strict=True):
            standing = label[first]
            if not self._stays and (standing < 0).all():
                continue
            self._match(chunk, first, standing)
            begin, last = int(step[first]), int(step[end - 1])
            for visit in passages:
                if begin <= visit.end <= last:
                    self._cut(chunk, first + visit.end - begin, visit.tunnel)
            for stay in self._stays:
                if stay.now:
                    stay.last = last
                    stay.distance, stay.laden = distance[end - 1].copy(), frames.laden[end - 1].copy()
            self._end_gone(chunk, first, end)
        self._last_step = int(step[-1])

    def standing(self, transits: float = TRANSITS) -> list[tuple[int, frozenset[int]]]:
        """Return start and members of what stands at present, and has for longer than a clog must."""
        return [
            (stay.onset.step, frozenset(stay.members))
            for stay in self._stays
            if self._transits(stay, stay.last + 1) > transits
        ]

    def finish(self) -> list[Clog]:
        """End the run, and what still stands with it; returns all that was found, by its start."""
        for stay in self._stays:
            self._end(stay, Ending.RUN_ENDED, stay.last + 1)
        self._stays = []
        self.found.sort(key=lambda clog: (clog.start, clog.end, clog.members))
        return self.found

    def _match(self, chunk: _Chunk, row: int, label: Integers) -> None:
        """Give every group of a row to the stay that it continues, or begin one."""
        before, stays = [(stay, stay.now) for stay in self._stays], []
        recent = {id(stay): stay.now or stay.members for stay in self._stays}
        for stay in self._stays:
            stay.now = set()
        for one in np.unique(label[label >= 0]).tolist():
            group = set(np.flatnonzero(label == one).tolist())
            mine = [stay for stay, _ in before if recent[id(stay)] & group]
            if not mine:
                stays.append(self._begin(chunk, row, group))
                continue
            # Groups that have grown together go on as the oldest of them.
            oldest = min(mine, key=lambda stay: stay.onset.step)
            oldest.now |= group
            for stay in mine:
                oldest.members |= stay.members
                if stay is not oldest:
                    before = [pair for pair in before if pair[0] is not stay]
                    recent[id(oldest)] = recent[id(oldest)] | recent[id(stay)]
            oldest.members |= group
        self._stays = [stay for stay, _ in before] + stays

    def _begin(self, chunk: _Chunk, row: int, group: set[int]) -> _Stay:
        place = chunk.frames.pose[row, sorted(group), :2]
        cell_row, cell_column = self._tunnels.cells(place)
        tunnel = int(self._tunnels.near[cell_row, cell_column].max())
        step = int(chunk.frames.step[row])
        onset = self._onset(chunk, row, group, max(0, step - self._finder.hold))
        laden = chunk.frames.laden[row].copy()
        return _Stay(tunnel, onset, set(group), set(group), step, chunk.distance[row].copy(), laden)

    def _onset(self, chunk: _Chunk, row: int, group: set[int], step: int) -> _Onset:
        members = sorted(group)
        x, y = chunk.frames.pose[row, members, :2].mean(axis=0).tolist()
        distance = float(chunk.distance[row, members].mean())
        return _Onset(step, self._cause(chunk, row, members), (x, y), distance)

    def _cause(self, chunk: _Chunk, row: int, members: list[int]) -> Cause:
        link = chunk.groups.link[row]
        distance, laden = chunk.distance[row], chunk.frames.laden[row]
        apart = ABREAST * self._arena.robot.length
        if any(
            link[out, back] and distance[out] < distance[back] - apart
            for out in members
            if not laden[out]
            for back in members
            if laden[back]
        ):
            return Cause.HEAD_ON
        if chunk.groups.pellet[row, members].any():
            return Cause.PELLET
        pose = chunk.frames.pose[row, members]
        inside = self._tunnels.inside[self._tunnels.cells(pose[:, :2])] >= 0
        across = np.abs(self._along(pose)) < ACROSS
        return Cause.TURNING if (inside & across).any() else Cause.QUEUE

    def _along(self, pose: Floats) -> Floats:
        """Return the cosine between headings and the way from home, for poses [n, 3]."""
        step = 0.25 * self._tunnels.cell_size
        x, y = (
            self._tunnels.distance_to_home(pose[:, :2] + offset)
            - self._tunnels.distance_to_home(pose[:, :2] - offset)
            for offset in (np.array([step, 0.0]), np.array([0.0, step]))
        )
        size = np.maximum(np.hypot(x, y), 1e-12)
        return np.asarray((x * np.cos(pose[:, 2]) + y * np.sin(pose[:, 2])) / size)

    def _cut(self, chunk: _Chunk, row: int, tunnel: int) -> None:
        """Somebody got through a tunnel: the clock of the groups that stand there starts anew."""
        step = int(chunk.frames.step[row])
        for stay in self._stays:
            if stay.tunnel == tunnel and stay.now and stay.onset.step < step:
                self._end(stay, Ending.PASSAGE, step)
                stay.members = set(stay.now)
                stay.onset = self._onset(chunk, row, stay.now, step)

    def _end_gone(self, chunk: _Chunk, first: int, end: int) -> None:
        """End the stays of groups that have been gone for `HOLD` somewhere in rows `first` to `end`."""
        step, kept = chunk.frames.step, []
        for stay in self._stays:
            back = stay.last + self._finder.hold
            if stay.now or int(step[end - 1]) < back:
                kept.append(stay)
                continue
            row = max(first, end - 1 - (int(step[end - 1]) - back))
            self._end(stay, self._how(chunk, row, stay), stay.last + 1)
        self._stays = kept

    def _how(self, chunk: _Chunk, row: int, stay: _Stay) -> Ending:
        """Return how a group came apart, from where its members have gone until `row`."""
        members = sorted(stay.members)
        if (chunk.frames.laden[row, members] & ~stay.laden[members]).any():
            return Ending.TOOK_PELLET
        way = chunk.distance[row, members] - stay.distance[members]
        most = int(np.abs(way).argmax())
        if abs(way[most]) < 0.5 * self._arena.robot.length:
            return Ending.LET_GO
        ahead = (way[most] > 0.0) != stay.laden[members[most]]
        return Ending.WENT_ON if ahead else Ending.BACKED_OFF

    def _transits(self, stay: _Stay, end: int) -> float:
        period = self._arena.timing.decision_period
        return (end - stay.onset.step) * period / float(self._tunnels.transit_time[stay.tunnel])

    def _end(self, stay: _Stay, ending: Ending, end: int) -> None:
        transits, onset = self._transits(stay, end), stay.onset
        if transits >= SHORTEST:
            self.found.append(
                Clog(
                    stay.tunnel,
                    onset.step,
                    end,
                    tuple(sorted(stay.members)),
                    onset.cause,
                    ending,
                    onset.place,
                    onset.distance,
                    transits,
                )
            )


def clogs_among(found: Sequence[Clog], transits: float = TRANSITS) -> list[Clog]:
    """Return what of `found` lasted longer than `transits` free-flow transit times."""
    return [clog for clog in found if clog.transits > transits]


def clogged_decisions(clogs: Sequence[Clog], decisions: int) -> int:
    """Return after how many of the decisions 1 to `decisions` at least one of the clogs stood."""
    standing = np.zeros(decisions + 1, dtype=np.bool_)
    for clog in clogs:
        standing[max(clog.start, 1) : clog.end] = True
    return int(standing.sum())
