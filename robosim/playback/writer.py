"""Columns of frames to what the viewer draws: one call an entity and chunk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from robosim.arena.model import Arena
from robosim.episodes.columns import FrameColumns
from robosim.playback import entities
from robosim.playback.bodies import BodyWriter
from robosim.playback.changes import changed_rows
from robosim.playback.sending import Stream
from robosim.world.contacts import ContactKind, onsets

REWARD_STEPS = 20
"""Decisions between two points of the reward plot; each is the mean of as many."""
HARD = 0.5
"""Impulse of a hard contact, as a share of the momentum of a robot at top speed."""
LOG_PAUSE = 3.0
"""A pair of robots is logged again after this long without a hard contact, s."""


class FrameWriter(BodyWriter):
    """Writes chunks of frames to a stream, and remembers what the viewer already shows."""

    def __init__(self, stream: Stream, arena: Arena, robots: int) -> None:
        super().__init__(stream, arena, robots)
        self._touching = False
        self._last_step = -1
        self._paused = False
        self._last_hard: dict[int, float] = {}
        sheet = arena.robot
        self._stopping_impulse = sheet.mass * sheet.top_speed
        self._contact_radius = 0.12 * sheet.width

    def write(self, frames: FrameColumns, pauses: Sequence[int] = ()) -> None:
        """Write all rows of `frames`.

        `pauses` are the rows, in order, before which (or after the last of which) a pause lies: the lanes of
        modes are empty there, and no event is written of what happened meanwhile.
        """
        self._note_pauses(frames, pauses)
        self.write_modes(frames)
        if frames.rows == 0:
            return
        self.write_bodies(frames)
        self._write_contacts(frames)
        self._write_collision_log(frames)
        self._write_delivered(frames)
        self._write_plots(frames)

    def _note_pauses(self, frames: FrameColumns, pauses: Sequence[int]) -> None:
        """Find where lanes end, and which rows come after a pause."""
        self._lane_ends = np.array(
            [(frames.step[row - 1] if row else self._last_step) + 1 for row in pauses], dtype=np.int64
        )
        after = [0, *pauses] if self._paused else pauses
        self._anew = np.array([row for row in after if row < frames.rows], dtype=np.intp)
        if frames.rows:
            self._last_step = int(frames.step[frames.rows - 1])
            self._paused = False
        self._paused |= frames.rows in pauses

    def _write_contacts(self, frames: FrameColumns) -> None:
        # Bodies that only just touch pass nothing on: there is nothing to see.
        felt = ~(frames.contact_impulse[: frames.contacts] <= 0.0)
        count = np.bincount(frames.row_of_contact()[felt], minlength=frames.rows)
        touching = count > 0
        # A row with nothing in it takes the last contacts away once they are over.
        over = changed_rows(touching, np.array(self._touching)) & ~touching
        self._touching = bool(touching[-1])
        rows = np.flatnonzero(touching | over)
        if len(rows) == 0:
            return
        impulse = frames.contact_impulse[: frames.contacts][felt]
        # In a world without forces every contact is drawn alike, as one that stops a robot.
        size = np.sqrt(np.minimum(np.nan_to_num(impulse / self._stopping_impulse, nan=1.0), 4.0))
        columns = [
            *rr.Points2D.columns(
                positions=frames.contact_position[: frames.contacts][felt].astype(np.float32),
                radii=(self._contact_radius * (0.3 + size)).astype(np.float32),
                class_ids=frames.contact_kind[: frames.contacts][felt].astype(np.uint16),
            ).partition(count[rows]),
            *rr.AnyValues.columns(impulse=impulse.astype(np.float32)).partition(count[rows]),
        ]
        self._send(entities.CONTACTS, frames, rows, columns)

    def _write_collision_log(self, frames: FrameColumns) -> None:
        impulse = frames.contact_impulse[: frames.contacts]
        hard = ~(impulse < HARD * self._stopping_impulse) & (
            frames.contact_kind[: frames.contacts] == ContactKind.ROBOT_ROBOT
        )
        events = np.flatnonzero(hard)
        pair = np.sort(frames.contact_pair[events], axis=1)
        time = frames.contact_time[events]
        new = events[onsets(pair[:, 0] * self._robots + pair[:, 1], time, self._last_hard, LOG_PAUSE)]
        if len(new) == 0:
            return
        text = [
            f"{a} and {b} hit each other" + ("" if np.isnan(strength) else f", {strength:.3f} N s")
            for (a, b), strength in zip(frames.contact_pair[new].tolist(), impulse[new].tolist(), strict=True)
        ]
        columns = rr.TextLog.columns(text=text, level=["WARN"] * len(text))
        self._send(
            entities.COLLISION_LOG, frames, frames.row_of_contact()[new], columns, frames.contact_time[new]
        )

    def _write_delivered(self, frames: FrameColumns) -> None:
        delivered = frames.delivered[: frames.rows]
        before = self._before.get(entities.DELIVERED)
        rows = self._new_rows(entities.DELIVERED, delivered, also=[-1])
        total = delivered.sum(axis=1)
        self._send(
            entities.DELIVERED, frames, rows, rr.Scalars.columns(scalars=total[rows].astype(np.float64))
        )
        each = rr.Scalars.columns(scalars=delivered[rows].astype(np.float64))
        self._send(entities.DELIVERED_BY_ROBOT, frames, rows, each)
        gained = np.diff(delivered, axis=0, prepend=delivered[:1] if before is None else before[None])
        # What was delivered during a pause is counted, but no event.
        gained[self._anew] = 0
        at, who = np.nonzero(gained > 0)
        if len(at) == 0:
            return
        text = [
            f"{robot} brings home pellet {count}"
            for robot, count in zip(who.tolist(), total[at].tolist(), strict=True)
        ]
        columns = rr.TextLog.columns(text=text, level=["INFO"] * len(text))
        self._send(entities.DELIVERY_LOG, frames, at, columns)

    def _write_plots(self, frames: FrameColumns) -> None:
        # A line ends where the run ends, so its last row is written even when it says nothing new.
        density = frames.density[: frames.rows]
        rows = self._new_rows(entities.DENSITY, density, also=[-1])
        self._send(entities.DENSITY, frames, rows, rr.Scalars.columns(scalars=density[rows]))
        ends = np.append(np.arange(REWARD_STEPS, frames.rows, REWARD_STEPS), frames.rows)
        first = np.append(0, self._anew)
        starts = np.maximum(ends - REWARD_STEPS, first[np.searchsorted(first, ends) - 1])
        team = frames.reward[: frames.rows].mean(axis=1, dtype=np.float64)
        if np.isnan(team).all():
            return
        sums = np.append(0.0, np.cumsum(team))
        mean = (sums[ends] - sums[starts]) / (ends - starts)
        self._send(entities.REWARD, frames, ends - 1, rr.Scalars.columns(scalars=mean))
