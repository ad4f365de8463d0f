"""Control periods to what the viewer draws: commands, reasons and events beside the scene."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.arena.outline import body_outline
from robosim.episodes.columns import FrameColumns
from robosim.episodes.control_frame import ControlFrame
from robosim.playback import entities, palette
from robosim.playback.bodies import BodyWriter
from robosim.playback.sending import Stream
from robosim.robot.team import per_wheel
from robosim.world.state import Gripper

TOUCHABLE = ("robot", "wall", "pellet")
"""What the rows of `ControlFrame.touched` are."""
MOST_COLOURED = 100
"""Kinds of reasons that get a colour of their own."""

Event = tuple[int, str, str, str]
"""Row, path, text and level."""


class ControlWriter(BodyWriter):
    """Writes control periods to a stream, chunk by chunk, and remembers what the viewer already shows."""

    def __init__(self, stream: Stream, arena: Arena, robots: int, action_names: Sequence[str]) -> None:
        super().__init__(stream, arena, robots)
        team = arena.team(robots)
        self._names = np.array([*action_names], dtype=object)
        self._rings = [body_outline(sheet) for sheet in team.sheets]
        self._colours = np.array(palette.robot_colours(team), dtype=np.uint8)
        self._cell = arena.cell_size
        self._length = np.asarray(team.sheet.length) * np.ones(robots)
        self._half_base = 0.5 * np.asarray(team.sheet.wheel_base) * np.ones(robots)
        self._top = per_wheel(team.sheet.max_wheel_speed) * np.ones((robots, 1))
        self._line = 0.04 * arena.robot.width
        self._shown: dict[str, list[str]] = {}
        self._kinds: dict[str, None] = {}
        self._last: ControlFrame | None = None
        self._send_styles()

    def write(self, columns: FrameColumns, frames: Sequence[ControlFrame], *, own_map: bool) -> None:
        """Write all rows of `columns`; `frames` are the same rows, with what a scene lacks.

        Without a map of the controller's own there are no pheromones to write.
        """
        self.write_modes(columns)
        self.write_bodies(columns, pheromone=own_map)
        self._write_lanes(columns, frames)
        self._write_rings(columns, frames)
        self._write_targets(columns, frames)
        self._write_wheels(columns, frames)
        self._write_plots(columns, frames)
        self._write_events(columns, frames)
        self._last = frames[-1]

    def finish(self) -> None:
        """Write the colours of the reasons that are known by now."""
        kinds = list(self._kinds)[:MOST_COLOURED]
        colours = [palette.ROBOTS[number % len(palette.ROBOTS)] for number in range(len(kinds))]
        for robot in range(self._robots) if kinds else ():
            style = rr.StateConfiguration(values=kinds, labels=kinds, colors=colours)
            self._stream.log(entities.lane(entities.STOPS, robot), style, static=True)

    def _send_styles(self) -> None:
        for path in (entities.TARGETS, entities.WHEELS):
            line = rr.LineStrips2D.from_fields(radii=self._line, draw_order=35.0)
            self._stream.log(path, line, static=True)
        for path in (entities.LEFT_SPEED, entities.RIGHT_SPEED, entities.AGE):
            series = rr.SeriesLines(
                names=[f"robot {robot}" for robot in range(self._robots)],
                colors=self._colours,
                interpolation_mode="Linear" if path == entities.AGE else "StepAfter",
                aggregation_policy="Off",
            )
            self._stream.log(path, series, static=True)

    def _write_lanes(self, columns: FrameColumns, frames: Sequence[ControlFrame]) -> None:
        action = np.array([frame.action for frame in frames])
        touched = np.array([frame.touched for frame in frames])
        for robot in range(self._robots):
            reasons = [_kind(frame.stopped[robot]) for frame in frames]
            self._kinds |= dict.fromkeys(reason for reason in reasons if reason)
            self._write_lane(columns, entities.STOPS, robot, reasons)
            self._write_lane(columns, entities.DECIDED, robot, self._names[action[:, robot]].tolist())
            met = [", ".join(np.array(TOUCHABLE)[one].tolist()) for one in touched[:, :, robot]]
            self._write_lane(columns, entities.TOUCHED, robot, met)

    def _write_lane(self, columns: FrameColumns, kind: str, robot: int, states: list[str]) -> None:
        """Write where a lane changes; an empty state ends it."""
        path = entities.lane(kind, robot)
        before = [*self._shown.get(path, [""]), *states[:-1]]
        rows = np.array(
            [row for row, (one, two) in enumerate(zip(before, states, strict=True)) if one != two]
        )
        self._shown[path] = states[-1:]
        if len(rows):
            new = [states[row] for row in rows]
            count = [1 if state else 0 for state in new]
            states_there = rr.StateChange.columns(state=[state for state in new if state]).partition(count)
            self._send(path, columns, rows, states_there)

    def _write_rings(self, columns: FrameColumns, frames: Sequence[ControlFrame]) -> None:
        stopped = np.array([[bool(reason) for reason in frame.stopped] for frame in frames])
        for robot, ring in enumerate(self._rings):
            rows = self._new_rows(entities.ring(robot), stopped[:, robot])
            if len(rows):
                count = stopped[rows, robot].astype(np.int64)
                strips = rr.LineStrips2D.columns(strips=[ring] * int(count.sum())).partition(count)
                self._send(entities.ring(robot), columns, rows, strips)

    def _write_targets(self, columns: FrameColumns, frames: Sequence[ControlFrame]) -> None:
        """Draw the chosen cells as squares, and a line to each from where it was chosen."""
        target = np.array([frame.target for frame in frames])
        place = np.array([frame.pose[:, :2] for frame in frames])
        there = np.isfinite(target).all(axis=2)
        target = np.where(there[:, :, None], target, 0.0)
        decides = np.flatnonzero([frame.decides for frame in frames])
        rows = self._new_rows(
            entities.TARGETS, np.concatenate([target, there[:, :, None]], axis=2), also=decides
        )
        if len(rows) == 0:
            return
        strips, colours = [], []
        # Robots may choose the same cell: their squares lie within each other.
        half = self._cell * (0.46 - 0.03 * (np.arange(self._robots) % 8))
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
        for row in rows:
            for robot in np.flatnonzero(there[row]):
                middle = target[row, robot]
                strips += [middle + half[robot] * corners, np.array([place[row, robot], middle])]
                colours += [self._colours[robot]] * 2
        lines = rr.LineStrips2D.columns(strips=strips, colors=np.array(colours).reshape(-1, 3))
        self._send(entities.TARGETS, columns, rows, lines.partition(2 * there[rows].sum(axis=1)))

    def _write_wheels(self, columns: FrameColumns, frames: Sequence[ControlFrame]) -> None:
        """Draw each wheel's command as a line at the robot's side, as long as it at top speed."""
        pose = np.array([frame.pose for frame in frames])
        speeds = np.array([frame.wheel_speeds for frame in frames])
        turning = speeds != 0.0
        rows = self._new_rows(
            entities.WHEELS, np.concatenate([pose, speeds], axis=2) * turning.any(axis=2)[..., None]
        )
        if len(rows) == 0:
            return
        pose, speeds, turning = pose[rows], speeds[rows], turning[rows]
        ahead = np.stack([np.cos(pose[..., 2]), np.sin(pose[..., 2])], axis=-1)
        left = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
        side = np.array([1.0, -1.0])[:, None] * (self._half_base[:, None] * left)[:, :, None, :]
        start = pose[..., None, :2] + side
        reach = np.clip(speeds / self._top, -1.0, 1.0) * self._length[:, None]
        end = start + reach[..., None] * ahead[..., None, :]
        strips = np.stack([start, end], axis=-2)[turning].astype(np.float32)
        lines = rr.LineStrips2D.columns(
            strips=strips, colors=np.tile(np.array(palette.WHEELS.colour, np.uint8), (len(strips), 1))
        )
        self._send(entities.WHEELS, columns, rows, lines.partition(turning.sum(axis=(1, 2))))

    def _write_plots(self, columns: FrameColumns, frames: Sequence[ControlFrame]) -> None:
        speeds = np.array([frame.wheel_speeds for frame in frames])
        every = np.arange(len(frames))
        for path, side in ((entities.LEFT_SPEED, 0), (entities.RIGHT_SPEED, 1)):
            rows = self._new_rows(path, speeds[:, :, side], also=[-1])
            self._send(path, columns, rows, rr.Scalars.columns(scalars=speeds[rows, :, side]))
        age = np.array([frame.age for frame in frames])
        self._send(entities.AGE, columns, every, rr.Scalars.columns(scalars=age))

    def _write_events(self, columns: FrameColumns, frames: Sequence[ControlFrame]) -> None:
        events: dict[str, list[Event]] = {}
        before = self._last
        for row, frame in enumerate(frames):
            for event in _events(row, before, frame):
                events.setdefault(event[1], []).append(event)
            before = frame
        for path, found in events.items():
            rows = np.array([event[0] for event in found])
            text = rr.TextLog.columns(text=[event[2] for event in found], level=[event[3] for event in found])
            self._send(path, columns, rows, text)


def _events(row: int, before: ControlFrame | None, now: ControlFrame) -> Iterator[Event]:
    """Yield what has changed from one control period to the next, in words."""
    if now.begins:
        yield row, entities.STOP_LOG, "the controller begins", "INFO"
        before = None
    held = before.emergency if before else ""
    if now.emergency != held:
        text = f"all are held: {now.emergency}" if now.emergency else "the emergency stop is over"
        yield row, entities.STOP_LOG, text, "ERROR" if now.emergency else "INFO"
    for robot, reason in enumerate(now.stopped):
        was = before.stopped[robot] if before else ""
        if _kind(reason) == _kind(was) or reason == now.emergency != "" or (not reason and was == held != ""):
            continue
        text = f"{robot} is stopped: {reason}" if reason else f"{robot} goes on"
        yield row, entities.STOP_LOG, text, "WARN" if reason else "INFO"
    moves = now.unstopped & ~(before.unstopped if before else np.zeros_like(now.unstopped))
    for robot in np.flatnonzero(moves).tolist():
        yield row, entities.STOP_LOG, f"{robot} is held, but still moves or is not seen", "ERROR"
    yield from _gripper_events(row, before, now)


def _gripper_events(row: int, before: ControlFrame | None, now: ControlFrame) -> Iterator[Event]:
    was: NDArray[np.int8] = before.gripper if before else np.full_like(now.gripper, Gripper.KEEP)
    for robot in np.flatnonzero((now.gripper != was) & (now.gripper != Gripper.KEEP)).tolist():
        what = "take a pellet" if now.gripper[robot] == Gripper.TAKE else "open its gripper"
        yield row, entities.GRIPPER_LOG, f"{robot} is told to {what}", "INFO"
    if before is None:
        return
    for robot in np.flatnonzero(now.laden != before.laden).tolist():
        text = f"{robot} {'holds a pellet' if now.laden[robot] else 'no longer holds a pellet'}"
        yield row, entities.GRIPPER_LOG, text, "INFO"


def _kind(reason: str) -> str:
    """Return a reason without its numbers, which change in every period."""
    return re.sub(r"-?\d+(\.\d+)?(e[+-]?\d+)?", "…", reason)
