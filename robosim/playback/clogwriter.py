"""Clogs to what the viewer draws: rings and links in the arena, intervals below it, lines in the log."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from robosim.analysis.clogs.clog import Clog, Ending
from robosim.arena.model import Arena
from robosim.arena.outline import body_outline
from robosim.playback import entities, palette
from robosim.playback.changes import changed_rows
from robosim.playback.clogs import Drawn, NumberedClog, Settled
from robosim.playback.sending import Stream, send_rows

LINK_GRID = 0.01
"""Links are written again when one of their ends moved to another step of this grid, m."""


class ClogWriter:
    """Writes clogs to a stream, and remembers what the viewer already shows."""

    def __init__(self, stream: Stream, arena: Arena, robots: int) -> None:
        self._stream = stream
        self._robots = robots
        self._period = arena.timing.decision_period
        self._rings = [body_outline(sheet) for sheet in arena.team(robots).sheets]
        self._member = np.zeros(robots, dtype=np.bool_)
        self._upper = np.triu_indices(robots, 1)
        self._links = self._grid(np.zeros((1, robots, 2)), np.zeros((1, robots, robots), dtype=np.bool_))[0]
        self._lanes: list[_Lane] = []

    def write(self, settled: Settled) -> None:
        """Write what is new."""
        if len(settled.drawn.step):
            self._write_rings(settled.drawn)
            self._write_links(settled.drawn)
        if settled.clogs:
            self._write_intervals(settled.clogs, settled.until)
            self._write_log(settled.clogs)

    def finish(self) -> None:
        """Write the colours of the intervals that are known by now."""
        for number, lane in enumerate(self._lanes):
            if lane.coloured == len(lane.colours):
                continue
            lane.coloured = len(lane.colours)
            self._stream.log(
                entities.clogs(number),
                rr.StateConfiguration(
                    values=list(lane.colours),
                    labels=list(lane.colours),
                    colors=list(lane.colours.values()),
                ),
                static=True,
            )

    def _send(self, path: str, step: NDArray[np.integer], columns: Any) -> None:
        send_rows(self._stream, path, step, step * np.float64(self._period), columns)

    def _write_rings(self, drawn: Drawn) -> None:
        for robot in range(self._robots):
            member = drawn.member[:, robot]
            rows = np.flatnonzero(changed_rows(member, self._member[robot : robot + 1]))
            if len(rows):
                count = member[rows].astype(np.int64)
                rings = rr.LineStrips2D.columns(strips=[self._rings[robot]] * int(count.sum())).partition(
                    count
                )
                self._send(entities.ring(robot), drawn.step[rows], rings)
        self._member = drawn.member[-1].copy()

    def _write_links(self, drawn: Drawn) -> None:
        links = self._grid(drawn.place, drawn.link)
        rows = np.flatnonzero(changed_rows(links, self._links))
        self._links = links[-1].copy()
        if len(rows) == 0:
            return
        row, one, other = np.nonzero(np.triu(drawn.link[rows]))
        count = np.bincount(row, minlength=len(rows))
        pairs = np.stack([one, other], axis=1)
        strips = drawn.place[rows[row][:, None], pairs].astype(np.float32)
        columns = [
            *rr.LineStrips2D.columns(strips=strips).partition(count),
            *rr.AnyValues.columns(linked=pairs.ravel().astype(np.uint16)).partition(2 * count),
        ]
        self._send(entities.CLOGS, drawn.step[rows], columns)

    def _grid(self, place: NDArray[np.float64], link: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Return rows [rows, n] that differ when what is drawn does: who is linked, and the ends."""
        steps = np.rint(place * (1.0 / LINK_GRID)).astype(np.int32)
        linked = np.asarray(link.any(axis=2))
        ends = np.where(linked[:, :, None], steps, 0).reshape(len(place), -1)
        return np.concatenate([ends, link[:, *self._upper]], axis=1, dtype=np.int32)

    def _write_intervals(self, clogs: list[NumberedClog], until: int) -> None:
        for _, clog, parts in clogs:
            if not parts:
                continue
            number = next((i for i, lane in enumerate(self._lanes) if lane.free <= clog.start), -1)
            if number < 0:
                number = len(self._lanes)
                self._lanes.append(_Lane())
            self._lanes[number].take(clog, parts, until)
        for number, lane in enumerate(self._lanes):
            if lane.rows:
                # Of two rows at one time the later counts: a clog may begin where the one before it ends.
                steps, states = zip(*lane.rows, strict=True)
                count = [1 if state else 0 for state in states]
                columns = rr.StateChange.columns(state=[state for state in states if state]).partition(count)
                self._send(entities.clogs(number), np.array(steps, dtype=np.int64), columns)
                lane.rows.clear()

    def _write_log(self, clogs: list[NumberedClog]) -> None:
        lines: list[tuple[int, str]] = []
        for number, clog, parts in clogs:
            if not parts:
                continue
            seconds = (clog.end - clog.start) * self._period
            if parts[0][0] == clog.start:
                lines.append((clog.start, start_line(number, clog, seconds)))
            if parts[-1][1] == clog.end and clog.ending is not Ending.RUN_ENDED:
                text = f"clog {number} is over after {seconds:.0f} s: {clog.ending.value}"
                lines.append((clog.end, text))
        if lines:
            steps, texts = zip(*lines, strict=True)
            columns = rr.TextLog.columns(
                text=texts, level=["WARN"] * len(texts), color=[palette.CLOG.colour] * len(texts)
            )
            self._send(entities.CLOG_LOG, np.array(steps, dtype=np.int64), columns)


class _Lane:
    """A row of intervals that do not overlap."""

    def __init__(self) -> None:
        self.free = 0
        """The first decision from which nothing stands in it."""
        self.rows: list[tuple[int, str]] = []
        """Decisions and labels yet to be written; an empty one ends an interval."""
        self.colours: dict[str, palette.Colour] = {}
        """By label."""
        self.coloured = 0
        """How many of them have been written."""

    def take(self, clog: Clog, parts: list[tuple[int, int]], until: int) -> None:
        """Put a clog into the lane; `until` is the first decision after what is known."""
        label = interval_label(clog)
        self.colours[label] = palette.CAUSES[clog.cause]
        for start, end in parts:
            self.rows.append((start, label))
            if end < until:
                self.rows.append((end, ""))
        self.free = clog.end


def interval_label(clog: Clog) -> str:
    """Return cause and members of a clog."""
    return f"{clog.cause.value}: {', '.join(map(str, clog.members))}"


def start_line(number: int, clog: Clog, seconds: float) -> str:
    """Return the line of the log where a clog begins."""
    robots = "robot" if len(clog.members) == 1 else "robots"
    over = "not over at the end" if clog.ending is Ending.RUN_ENDED else f"ended: {clog.ending.value}"
    x, y = clog.place
    return (
        f"clog {number}: {clog.cause.value}, {robots} {', '.join(map(str, clog.members))}, "
        f"at ({x:.2f}, {y:.2f}) m, {seconds:.0f} s, {over}"
    )
