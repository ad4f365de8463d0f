"""Clogs found in frames as they come, by the definition in `robosim.analysis.clogs.clog`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.analysis.clogs.clog import SHORTEST, TRANSITS, Cause, Clog, Ending
from robosim.analysis.clogs.groups import GroupFinder, Groups
from robosim.analysis.measure.tunnels import Tunnels
from robosim.analysis.measure.visits import Visit
from robosim.arena.model import Arena
from robosim.episodes.columns import FrameColumns

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

ACROSS = 0.5
"""A robot stands across the tunnel when the cosine between its heading and the axis is smaller."""
ABREAST = 0.25
"""Robots nearer to each other than this along the tunnel have neither passed nor yet to pass, in lengths."""
_RANK = {cause: number for number, cause in enumerate(Cause)}


@dataclass(frozen=True, slots=True)
class _Onset:
    """How a piece of a stay began."""

    step: int
    seen: int
    """The decision after which it was recognised, or cut."""
    cause: Cause
    place: tuple[float, float]
    distance: float


@dataclass(slots=True, eq=False)
class _Stay:
    """A group in time, since it was recognised or last cut by a passage."""

    tunnel: int
    since: int
    """When its first members came to a halt."""
    onset: _Onset
    members: set[int]
    """Every robot that was part of it since its onset."""
    now: set[int]
    """Who stands at present; nobody in a pause."""
    seen: dict[int, int]
    """The last decision after which each robot was part of it; nobody that has left for `HOLD`."""
    last: int
    """The last decision after which it stood."""
    stood: list[int]
    """Who stood then, in order."""
    distance: Floats
    """[robots] distances to home then, m."""
    laden: Bools
    """[robots] who was laden then."""

    def take_in(self, other: _Stay) -> None:
        """Go on as one with another stay, which has grown together with this one."""
        self.since = min(self.since, other.since)
        self.members |= other.members
        self.now |= other.now
        for robot, step in other.seen.items():
            self.seen[robot] = max(step, self.seen.get(robot, step))


class _Chunk(NamedTuple):
    """The rows at hand."""

    frames: FrameColumns
    distance: Floats
    groups: Groups
    picked: Integers
    """[rows, robots] last decision in which each robot took a pellet, or -1."""


class ClogFinder:
    """Takes chunks of frames and finds the clogs in them."""

    def __init__(self, arena: Arena, robots: int, tunnels: Tunnels) -> None:
        self._arena = arena
        self._tunnels = tunnels
        self._finder = GroupFinder(arena, robots, tunnels)
        self._stays: list[_Stay] = []
        self._shut = np.zeros(tunnels.count, dtype=np.int64)
        """[tunnels] the last decision in which a passage ended a stay in its pause."""
        self._laden = np.ones(robots, dtype=np.bool_)
        self._picked = np.full(robots, -1)
        self.groups = Groups(
            np.zeros((0, robots), dtype=np.int64),
            np.zeros((0, robots, robots), dtype=np.bool_),
            np.zeros((0, robots), dtype=np.bool_),
        )
        """Of the latest chunk."""
        self.found: list[Clog] = []
        """What has ended so far, standstills from `SHORTEST` transit times on; see `clogs_among`."""

    def add(self, frames: FrameColumns, distance: Floats, visits: Sequence[Visit]) -> None:
        """Take in the next rows, distances to home [rows, robots] in m, and the visits that ended in them."""
        passages = sorted((visit for visit in visits if visit.passage), key=lambda visit: visit.end)
        self.groups = self._finder.find(frames)
        chunk = _Chunk(frames, distance, self.groups, self._pickups(frames))
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
                    self._cut(chunk, first, first + visit.end - begin, visit)
            for stay in self._stays:
                if stay.now:
                    self._update_cause(chunk, stay, first, end)
                    stay.last, stay.stood = last, sorted(stay.now)
                    stay.seen.update(dict.fromkeys(stay.now, last))
                    stay.distance, stay.laden = distance[end - 1].copy(), frames.laden[end - 1].copy()
            self._end_gone(chunk, end)

    def standing(self, transits: float = TRANSITS) -> list[tuple[int, frozenset[int]]]:
        """Return start and members of what stands at present, or pauses, and has long enough for a clog."""
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

    def _pickups(self, frames: FrameColumns) -> Integers:
        """Return for each row the last decision so far in which each robot took a pellet, or -1."""
        laden = frames.laden[: frames.rows]
        took = laden & ~np.concatenate([self._laden[None], laden[:-1]])
        steps = np.where(took, frames.step[: frames.rows, None], self._picked)
        picked = np.maximum.accumulate(steps, axis=0)
        self._laden, self._picked = laden[-1].copy(), picked[-1].copy()
        return picked

    def _match(self, chunk: _Chunk, row: int, label: Integers) -> None:
        """Give every group of a row to the stay that it continues, or begin one."""
        step = int(chunk.frames.step[row])
        for stay in self._stays:
            stay.now = set()
            stay.seen = {robot: seen for robot, seen in stay.seen.items() if step - seen <= self._finder.hold}
        for one in np.unique(label[label >= 0]).tolist():
            group = set(np.flatnonzero(label == one).tolist())
            mine = [stay for stay in self._stays if not group.isdisjoint(stay.seen)]
            if not mine:
                self._stays.append(self._begin(chunk, row, group))
                continue
            # Groups that have grown together go on as the oldest of them.
            oldest = min(mine, key=lambda stay: stay.onset.step)
            for stay in mine:
                if stay is not oldest:
                    oldest.take_in(stay)
                    self._stays.remove(stay)
            oldest.now |= group
            oldest.members |= group

    def _begin(self, chunk: _Chunk, row: int, group: set[int]) -> _Stay:
        place = chunk.frames.pose[row, sorted(group), :2]
        cell_row, cell_column = self._tunnels.cells(place)
        tunnel = int(self._tunnels.near[cell_row, cell_column].max())
        step = int(chunk.frames.step[row])
        since = max(step - self._finder.hold, int(self._shut[tunnel]))
        return _Stay(
            tunnel,
            since,
            self._onset(chunk, row, group, since),
            set(group),
            set(group),
            dict.fromkeys(group, step),
            step,
            sorted(group),
            chunk.distance[row].copy(),
            chunk.frames.laden[row].copy(),
        )

    def _onset(self, chunk: _Chunk, row: int, group: set[int], step: int) -> _Onset:
        members = sorted(group)
        x, y = chunk.frames.pose[row, members, :2].mean(axis=0).tolist()
        distance = float(chunk.distance[row, members].mean())
        seen = int(chunk.frames.step[row])
        return _Onset(step, seen, self._cause(chunk, row, members), (x, y), distance)

    def _update_cause(self, chunk: _Chunk, stay: _Stay, first: int, end: int) -> None:
        """Look for an earlier one of `Cause` in rows `first` to `end`, if they are in the first `HOLD`."""
        begin, onset = int(chunk.frames.step[first]), stay.onset
        rows = range(
            first + max(0, onset.seen + 1 - begin),
            min(end, first + onset.seen + self._finder.hold + 1 - begin),
        )
        for row in rows:
            cause = self._cause(chunk, row, sorted(stay.now))
            if _RANK[cause] < _RANK[stay.onset.cause]:
                stay.onset = replace(stay.onset, cause=cause)

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
        """Return the cosine between headings and the direction straight away from home, for poses [n, 3]."""
        step = 0.25 * self._tunnels.cell_size
        x, y = (
            self._tunnels.distance_to_home(pose[:, :2] + offset)
            - self._tunnels.distance_to_home(pose[:, :2] - offset)
            for offset in (np.array([step, 0.0]), np.array([0.0, step]))
        )
        size = np.maximum(np.hypot(x, y), 1e-12)
        return np.asarray((x * np.cos(pose[:, 2]) + y * np.sin(pose[:, 2])) / size)

    def _cut(self, chunk: _Chunk, first: int, row: int, visit: Visit) -> None:
        """Somebody got through a tunnel at `row`: for groups that stood there before, the clock starts anew.

        They have stood as they do since row `first`.
        """
        step = int(chunk.frames.step[row])
        for stay in self._stays:
            if stay.tunnel != visit.tunnel or visit.start < stay.since:
                continue
            if not stay.now:
                if step <= stay.last + self._finder.hold:
                    # In its pause: whoever comes back begins a stay of its own.
                    stay.seen = {}
                    self._shut[stay.tunnel] = step
            elif stay.onset.step < step:
                self._update_cause(chunk, stay, first, row)
                self._end(stay, Ending.PASSAGE, step)
                stay.members = set(stay.now)
                stay.onset = self._onset(chunk, row, stay.now, step)

    def _end_gone(self, chunk: _Chunk, end: int) -> None:
        """End the stays of groups that have been gone for `HOLD` somewhere before row `end`."""
        last, kept = int(chunk.frames.step[end - 1]), []
        for stay in self._stays:
            over = stay.last + self._finder.hold
            if stay.now or last < over:
                kept.append(stay)
                continue
            self._end(stay, self._ending(chunk, end - 1 - (last - over), stay), stay.last + 1)
        self._stays = kept

    def _ending(self, chunk: _Chunk, row: int, stay: _Stay) -> Ending:
        """Return what ended a stay, from where those that stood last have gone until `row`."""
        if (chunk.picked[row, stay.stood] > stay.last - self._finder.hold).any():
            return Ending.TOOK_PELLET
        outward = chunk.distance[row, stay.stood] - stay.distance[stay.stood]
        most = int(np.abs(outward).argmax())
        if abs(outward[most]) < 0.5 * self._arena.robot.length:
            return Ending.LET_GO
        ahead = (outward[most] > 0.0) != stay.laden[stay.stood[most]]
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
