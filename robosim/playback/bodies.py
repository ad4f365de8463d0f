"""Robots, modes, tracks, pellets and pheromones to what the viewer draws: one call an entity and chunk."""

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
from robosim.playback.sending import Stream, send_rows
from robosim.world.state import PelletStatus

POSITION_GRID = 1e-3
"""A body is written again when a coordinate moved to another step of this grid, m."""
HEADING_GRID = 5e-3
"""The same for a heading, rad."""
TRACK_GRID = 0.05
"""Tracks are drawn on a grid of this share of a robot's width; places that come again cost little."""

_MODE_LABELS = np.array([palette.MODES[mode].label for mode in Mode], dtype=object)
_MODE_COLOURS = np.array([palette.MODES[mode].colour for mode in Mode], dtype=np.uint8)


class BodyWriter:
    """Writes what a scene shows of a team, chunk by chunk, and remembers what the viewer already shows."""

    def __init__(self, stream: Stream, arena: Arena, robots: int) -> None:
        self._stream = stream
        self._robots = robots
        self._shape = (arena.rows, arena.columns)
        self._before: dict[str, NDArray[Any]] = {}
        self._lane_ends = np.empty(0, dtype=np.int64)
        self._anew = np.empty(0, dtype=np.intp)
        self._period = arena.timing.decision_period
        self._track_grid = TRACK_GRID * arena.robot.width

    def write_modes(self, frames: FrameColumns) -> None:
        """Write the lanes of modes."""
        for robot in range(self._robots):
            self._write_mode(frames, robot)

    def write_bodies(self, frames: FrameColumns, *, pheromone: bool = True) -> None:
        """Write robots, tracks, pellets and, where they are known, pheromones of one or more rows."""
        self._write_robots(frames)
        self._write_tracks(frames)
        self._write_pellets(frames)
        if pheromone:
            self._write_pheromone(frames)

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


def _transforms(pose: NDArray[np.float64]) -> rr.ComponentColumnList:
    translation = np.zeros((len(pose), 3), dtype=np.float32)
    translation[:, :2] = pose[:, :2]
    quaternion = np.zeros((len(pose), 4), dtype=np.float32)
    quaternion[:, 2] = np.sin(0.5 * pose[:, 2])
    quaternion[:, 3] = np.cos(0.5 * pose[:, 2])
    return rr.Transform3D.columns(translation=translation, quaternion=quaternion)
