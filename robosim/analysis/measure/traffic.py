"""Traffic in the tunnels: visits, flow against density, who is where, streamed in chunks of frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.analysis.measure.tunnels import Tunnels
from robosim.analysis.measure.visits import Visit, VisitLog
from robosim.arena.model import Arena
from robosim.episodes.columns import FrameColumns
from robosim.equality import EqualByValue
from robosim.robot.drivers import STOP

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

WINDOW = 30.0
"""Time over which flow and density are averaged for one point of the fundamental diagram, s."""
ACTIVE_WINDOW = 120.0
"""Time within which an active robot has been in a tunnel, s: two to four free round trips."""
MOVES_ALONG = 0.25
"""A robot moves along the tunnel in a decision that takes it along with this share of its top speed."""
PER_CELL = 4
"""Squares of the occupancy map to a side of a cell."""
TRACK_TIME = 1.5
"""Time between two points of a robot's line in the space-time diagram, s."""


class Windows(NamedTuple):
    """Averages over consecutive stretches of `WINDOW`, by Edie's definitions (1963)."""

    tunnel: Integers
    """[n] which tunnel."""
    density: Floats
    """[n] time that robots spend in the tunnel, over length and time: robots / m."""
    flow: Floats
    """[n] approach of the robots in the tunnel to their goals, over length and time: robots / s."""


@dataclass(slots=True, eq=False)
class Traffic(EqualByValue):
    """What the traffic of an episode came to."""

    visits: list[Visit]
    """By end, then by robot."""
    windows: Windows
    robots_in_tunnel: Integers
    """[robots + 1] decisions after which so many robots were in the tunnels."""
    bidirectional: int
    """Decisions in which laden and unladen robots moved along the tunnels at once."""
    unladen_cells: Integers
    """[rows, columns] decisions in which unladen robots moved along each cell of the tunnels."""
    laden_cells: Integers
    """[rows, columns] the same of laden robots."""
    occupancy: Integers
    """[rows * PER_CELL, columns * PER_CELL] decisions of a robot's middle there; row 0 at the bottom."""
    stops: Integers
    """[robots] decisions of each robot that were Stop."""
    active: Floats
    """[n] share of the robots that were in a tunnel within each stretch of `ACTIVE_WINDOW`."""
    track_step: Integers
    """[n] decisions of the space-time diagram."""
    track: NDArray[np.float32]
    """[n, robots] distance to home then, m."""
    track_tunnel: NDArray[np.int16]
    """[n, robots] tunnel, with its mouths, or -1."""
    track_laden: Bools
    """[n, robots]."""


class TrafficMeter:
    """Takes chunks of frames; between them it keeps counts, one row of state, and what it has found."""

    def __init__(self, arena: Arena, robots: int, tunnels: Tunnels) -> None:
        self._tunnels = tunnels
        self._robots = robots
        self._least_displacement = (
            MOVES_ALONG * arena.team(robots).sheet.top_speed * arena.timing.decision_period
        )
        period = arena.timing.decision_period
        self._period = period
        self._window = max(1, round(WINDOW / period))
        self._active_window = max(1, round(ACTIVE_WINDOW / period))
        self._track_every = max(1, round(TRACK_TIME / period))
        self._fine = arena.cell_size / PER_CELL
        self._log = VisitLog(tunnels)
        self._visits: list[Visit] = []
        self._distance = np.zeros(robots)
        self._laden = np.zeros(robots, dtype=np.bool_)
        self._begun = False
        self._decisions = 0
        shape = (arena.rows, arena.columns)
        self._count = np.zeros(robots + 1, dtype=np.int64)
        self._bidirectional = 0
        self._stops = np.zeros(robots, dtype=np.int64)
        self._cells = np.zeros((2, shape[0] * shape[1]), dtype=np.int64)
        self._occupancy = np.zeros(shape[0] * shape[1] * PER_CELL**2, dtype=np.int64)
        self._shape = shape
        self._window_time = np.zeros(tunnels.count, dtype=np.int64)
        self._window_approach = np.zeros(tunnels.count)
        self._windows: list[Floats] = []
        self._was_active = np.zeros(robots, dtype=np.bool_)
        self._active: list[float] = []
        self._tracks: list[tuple[Integers, NDArray[np.float32], NDArray[np.int16], Bools]] = []

    def add(self, frames: FrameColumns, distance: Floats) -> list[Visit]:
        """Take in the next rows, and return the visits that ended in them.

        `distance` [rows, robots] is the robots' distance to home, m. The first row of all is the state in
        which the run begins, and counts nowhere.
        """
        place, laden = frames.pose[: frames.rows, :, :2], frames.laden[: frames.rows]
        rows, columns = self._tunnels.cells(place)
        inside = self._tunnels.inside[rows, columns]
        first = 0 if self._begun else 1
        if first:
            self._begun = True
            self._distance, self._laden = distance[0], laden[0]
        ended = self._log.add(frames.step[: frames.rows], inside, distance)
        self._visits += ended
        was = np.concatenate([self._distance[None], distance[:-1]])[first:]
        carried = np.concatenate([self._laden[None], laden[:-1]])[first:]
        now = inside[first:]
        if len(now):
            self._add_windows(now, distance[first:] - was, carried)
            self._add_counts(now)
            # Who stands in a jam is no traffic: its lane and direction say nothing of how the team shares.
            moving = (now >= 0) & (np.abs(distance[first:] - was) >= self._least_displacement)
            self._add_lanes(moving, laden[first:], (rows[first:], columns[first:]))
            self._add_occupancy(place[first:])
            self._add_activity(now)
            self._stops += (frames.action[first : frames.rows] == STOP).sum(axis=0)
            self._decisions += len(now)
        self._add_tracks(frames.step[: frames.rows], distance, rows, columns, laden)
        self._distance, self._laden = distance[-1].copy(), laden[-1].copy()
        return ended

    def finish(self, step: int) -> Traffic:
        """Return everything; `step` is the last decision. Visits that are not over end nowhere."""
        visits = [*self._visits, *self._log.unfinished(step + 1)]
        visits.sort(key=lambda visit: (visit.end, visit.robot))
        windows = np.concatenate(self._windows) if self._windows else np.zeros((0, 3))
        rows, columns = self._shape
        steps, track, near, laden = (
            (np.concatenate(parts) for parts in zip(*self._tracks, strict=True))
            if self._tracks
            else (
                np.zeros(0, dtype=np.int64),
                np.zeros((0, self._robots), dtype=np.float32),
                np.zeros((0, self._robots), dtype=np.int16),
                np.zeros((0, self._robots), dtype=np.bool_),
            )
        )
        return Traffic(
            visits=visits,
            windows=Windows(windows[:, 0].astype(np.int64), windows[:, 1], windows[:, 2]),
            robots_in_tunnel=self._count.copy(),
            bidirectional=self._bidirectional,
            unladen_cells=self._cells[0].reshape(rows, columns).copy(),
            laden_cells=self._cells[1].reshape(rows, columns).copy(),
            occupancy=self._occupancy.reshape(rows * PER_CELL, columns * PER_CELL).copy(),
            stops=self._stops.copy(),
            active=np.array(self._active),
            track_step=steps,
            track=track,
            track_tunnel=near,
            track_laden=laden,
        )

    def _add_windows(self, now: Integers, outward: Floats, laden: Bools) -> None:
        """Add up time and approach to the goal in each tunnel, and close the windows that are full.

        `outward` [rows, robots] is by how much the distance to home grew, m.
        """
        count = self._tunnels.count
        if count == 0:
            return
        number = (np.arange(len(now)) + self._decisions) // self._window - self._decisions // self._window
        inside = now >= 0
        # What the window has so far comes first, and `bincount` adds in order: chunks change no bit.
        place = np.concatenate([np.arange(count), (number[:, None] * count + now)[inside]])
        approach = np.concatenate([self._window_approach, np.where(laden, -outward, outward)[inside]])
        size = (int(number[-1]) + 1) * count
        time = np.bincount(place, minlength=size).reshape(-1, count)
        time[0] += self._window_time - 1
        approached = np.bincount(place, approach, minlength=size).reshape(-1, count)
        full = (self._decisions + len(now)) // self._window - self._decisions // self._window
        length = self._tunnels.length
        for one in range(full):
            density = time[one] / (self._window * length)
            flow = approached[one] / (self._window * self._period * length)
            self._windows.append(np.stack([np.arange(count), density, flow], axis=1))
        nothing = full == len(time)
        self._window_time = np.zeros_like(time[0]) if nothing else time[-1].copy()
        self._window_approach = np.zeros_like(approached[0]) if nothing else approached[-1].copy()

    def _add_counts(self, now: Integers) -> None:
        within = (now >= 0).sum(axis=1)
        self._count += np.bincount(within, minlength=self._robots + 1)

    def _add_lanes(self, moving: Bools, laden: Bools, cell: tuple[Integers, Integers]) -> None:
        """Count in which cells of the tunnels the robots are that move along: `moving` [rows, robots]."""
        rows, columns = self._shape
        both = (moving & laden).any(axis=1) & (moving & ~laden).any(axis=1)
        self._bidirectional += int(both.sum())
        flat = cell[0] * columns + cell[1]
        for carries, cells in enumerate(self._cells):
            cells += np.bincount(flat[moving & (laden == carries)], minlength=rows * columns)

    def _add_occupancy(self, place: Floats) -> None:
        rows, columns = self._shape
        fine = np.floor(place * (1.0 / self._fine)).astype(np.int64)
        wide = columns * PER_CELL
        x = np.clip(fine[..., 0], 0, wide - 1)
        y = np.clip(fine[..., 1], 0, rows * PER_CELL - 1)
        self._occupancy += np.bincount((y * wide + x).ravel(), minlength=len(self._occupancy))

    def _add_activity(self, now: Integers) -> None:
        number = (np.arange(len(now)) + self._decisions) // self._active_window
        for one in range(int(number[0]), int(number[-1]) + 1):
            rows = np.flatnonzero(number == one)
            self._was_active |= (now[rows] >= 0).any(axis=0)
            if (int(rows[-1]) + self._decisions) % self._active_window == self._active_window - 1:
                self._active.append(float(self._was_active.mean()))
                self._was_active = np.zeros(self._robots, dtype=np.bool_)

    def _add_tracks(
        self, step: Integers, distance: Floats, rows: Integers, columns: Integers, laden: Bools
    ) -> None:
        taken = step % self._track_every == 0
        near = self._tunnels.near[rows[taken], columns[taken]].astype(np.int16)
        self._tracks.append(
            (step[taken].copy(), distance[taken].astype(np.float32), near, laden[taken].copy())
        )


def segregation(traffic: Traffic) -> float | None:
    """Return how far laden and unladen robots keep to different cells of the tunnels, 0 to 1.

    D = 1/2 sum |u_c / U - l_c / L| over the cells c, with the time in which unladen and laden robots move
    along them: the dissimilarity index (Duncan and Duncan 1955). Two separate lanes give 1, a shared one 0.
    None unless both have moved along a tunnel.
    """
    unladen, laden = traffic.unladen_cells.sum(), traffic.laden_cells.sum()
    if unladen == 0 or laden == 0:
        return None
    return float(0.5 * np.abs(traffic.unladen_cells / unladen - traffic.laden_cells / laden).sum())


def lapses(traffic: Traffic, decision_period: float) -> Floats:
    """Return the times between consecutive passages of the same tunnel, s (Garcimartin et al. 2014).

    Two robots that leave a tunnel in the same decision count as one passage.
    """
    ends: dict[int, set[int]] = {}
    for visit in traffic.visits:
        if visit.passage:
            ends.setdefault(visit.tunnel, set()).add(visit.end)
    parts = [np.diff(sorted(times)) * decision_period for _, times in sorted(ends.items())]
    return np.concatenate(parts) if parts else np.zeros(0)
