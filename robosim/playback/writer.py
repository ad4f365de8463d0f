"""Columns of frames to what the viewer draws: one call an entity and chunk."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.discretise.modes import Mode
from robosim.episodes.columns import FrameColumns
from robosim.playback import entities, palette
from robosim.playback.changes import changed_rows
from robosim.playback.scene import level_of_occupancy
from robosim.playback.sending import send_rows
from robosim.world.contacts import ContactKind, onsets
from robosim.world.state import PelletStatus

POSITION_GRID = 1e-3
"""A body is written again when a coordinate moved to another step of this grid, m."""
HEADING_GRID = 5e-3
"""The same for a heading, rad."""
TRACK_GRID = 0.05
"""Tracks are drawn on a grid of this share of a robot's width; places that come again cost little."""
REWARD_STEPS = 20
"""Decisions between two points of the reward plot; each is the mean of as many."""
HARD = 0.5
"""Impulse of a hard contact, as a share of the momentum of a robot at top speed."""
LOG_PAUSE = 3.0
"""A pair of robots is logged again after this long without a hard contact, s."""

_MODE_LABELS = np.array([palette.MODES[mode].label for mode in Mode], dtype=object)
_MODE_COLOURS = np.array([palette.MODES[mode].colour for mode in Mode], dtype=np.uint8)


class FrameWriter:
    """Writes chunks of frames to a stream, and remembers what the viewer already shows."""

    def __init__(self, stream: rr.RecordingStream, arena: Arena, robots: int) -> None:
        self._stream = stream
        self._robots = robots
        self._shape = (arena.rows, arena.columns)
        self._before: dict[str, NDArray[Any]] = {}
        self._touching = False
        self._last_step = -1
        self._paused = False
        self._lane_ends = np.empty(0, dtype=np.int64)
        self._anew = np.empty(0, dtype=np.intp)
        self._period = arena.timing.decision_period
        self._last_hard: dict[int, float] = {}
        sheet = arena.robot
        self._stopping_impulse = sheet.mass * sheet.top_speed
        self._contact_radius = 0.12 * sheet.width
        self._track_grid = TRACK_GRID * sheet.width

    def write(self, frames: FrameColumns, pauses: Sequence[int] = ()) -> None:
        """Write all rows of `frames`.

        `pauses` are the rows, in order, before which (or after the last of which) a pause lies: the lanes of
        modes are empty there, and no event is written of what happened meanwhile.
        """
        self._note_pauses(frames, pauses)
        for robot in range(self._robots):
            self._write_mode(frames, robot)
        if frames.rows == 0:
            return
        self._write_robots(frames)
        self._write_tracks(frames)
        self._write_pellets(frames)
        self._write_pheromone(frames)
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

    def _send(
        self,
        path: str,
        frames: FrameColumns,
        rows: NDArray[np.integer],
        columns: Iterable[rr.ComponentColumn],
        time: NDArray[np.float64] | None = None,
    ) -> None:
        times = frames.time[rows] if time is None else time
        send_rows(self._stream, path, frames.step[rows], times, columns)

    def _new_rows(
        self, key: str, values: NDArray[Any], *, also: NDArray[np.intp] | Sequence[int] = ()
    ) -> NDArray[np.intp]:
        changed = changed_rows(values, self._before.get(key))
        changed[np.asarray(also, dtype=np.intp)] = True
        rows = np.flatnonzero(changed)
        self._before[key] = values[-1].copy()
        return rows

    def _write_robots(self, frames: FrameColumns) -> None:
        pose = frames.pose[: frames.rows]
        on_grid = np.rint(pose * (1 / POSITION_GRID, 1 / POSITION_GRID, 1 / HEADING_GRID)).astype(np.int32)
        for robot in range(self._robots):
            path = entities.robot(robot)
            rows = self._new_rows(path, on_grid[:, robot])
            if len(rows):
                self._send(path, frames, rows, _transforms(pose[rows, robot]))
            mode = frames.mode[: frames.rows, robot]
            rows = self._new_rows(f"{path}/body", mode)
            if len(rows):
                colours = rr.LineStrips2D.columns(colors=_MODE_COLOURS[mode[rows]])
                self._send(f"{path}/body", frames, rows, colours)
            laden = frames.laden[: frames.rows, robot]
            rows = self._new_rows(f"{path}/outline", laden)
            if len(rows):
                held = np.array([palette.OUTLINE, palette.HELD_PELLET.colour], dtype=np.uint8)
                colours = rr.LineStrips2D.columns(colors=held[laden[rows].astype(np.intp)])
                self._send(f"{path}/outline", frames, rows, colours)

    def _write_mode(self, frames: FrameColumns, robot: int) -> None:
        path, ends = entities.mode(robot), self._lane_ends
        mode = frames.mode[: frames.rows, robot]
        rows = self._new_rows(path, mode, also=self._anew) if frames.rows else np.empty(0, dtype=np.intp)
        if len(rows) + len(ends) == 0:
            return
        # A row with nothing in it ends a lane; of two rows at one time the later counts.
        step = np.concatenate([ends, frames.step[rows]])
        time = np.concatenate([ends * self._period, frames.time[rows]])
        order = np.argsort(step, kind="stable")
        count = np.repeat([0, 1], [len(ends), len(rows)])[order]
        states = rr.StateChange.columns(state=_MODE_LABELS[mode[rows]]).partition(count)
        send_rows(self._stream, path, step[order], time[order], states)

    def _write_tracks(self, frames: FrameColumns) -> None:
        # All robots in one entity: a row for each robot alone would cost more than its place.
        on_grid = np.rint(frames.pose[: frames.rows, :, :2] * (1 / self._track_grid)).astype(np.int32)
        rows = self._new_rows(entities.TRACKS, on_grid)
        if len(rows):
            places = (on_grid[rows].reshape(-1, 2) * self._track_grid).astype(np.float32)
            columns = rr.Points2D.columns(positions=places).partition(np.full(len(rows), self._robots))
            self._send(entities.TRACKS, frames, rows, columns)

    def _write_pellets(self, frames: FrameColumns) -> None:
        places = frames.pellets[: frames.rows]
        on_grid = np.rint(places * (1 / POSITION_GRID)).astype(np.int32)
        for path, status in ((entities.LOOSE, PelletStatus.LOOSE), (entities.HELD, PelletStatus.HELD)):
            there = frames.pellet_status[: frames.rows] == status
            # A pellet in the other state must not count as moved: give it one place that never changes.
            rows = self._new_rows(path, np.where(there[:, :, None], on_grid, np.iinfo(np.int32).min))
            if len(rows):
                shown = there[rows]
                positions = places[rows][shown].astype(np.float32)
                columns = rr.Points2D.columns(positions=positions).partition(shown.sum(axis=1))
                self._send(path, frames, rows, columns)

    def _write_pheromone(self, frames: FrameColumns) -> None:
        levels = level_of_occupancy(frames.pheromone[: frames.pictures])
        new = self._new_rows(entities.PHEROMONE, levels) if len(levels) else np.empty(0, dtype=np.intp)
        if len(new) == 0:
            return
        rows, columns = self._shape
        picture = rr.components.ImageFormat(
            width=columns, height=rows, channel_datatype="U8", color_model="L"
        )
        images = rr.SegmentationImage.columns(
            buffer=levels[new].reshape(len(new), -1), format=[picture] * len(new)
        )
        self._send(entities.PHEROMONE, frames, frames.picture_row[new], images)

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
        sums = np.append(0.0, np.cumsum(team))
        mean = (sums[ends] - sums[starts]) / (ends - starts)
        self._send(entities.REWARD, frames, ends - 1, rr.Scalars.columns(scalars=mean))


def _transforms(pose: NDArray[np.float64]) -> rr.ComponentColumnList:
    translation = np.zeros((len(pose), 3), dtype=np.float32)
    translation[:, :2] = pose[:, :2]
    quaternion = np.zeros((len(pose), 4), dtype=np.float32)
    quaternion[:, 2] = np.sin(0.5 * pose[:, 2])
    quaternion[:, 3] = np.cos(0.5 * pose[:, 2])
    return rr.Transform3D.columns(translation=translation, quaternion=quaternion)
