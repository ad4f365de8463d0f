"""Watching episodes as they run: frames in, everything that is measured out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.analysis.clogs.clog import Clog
from robosim.analysis.clogs.finder import ClogFinder
from robosim.analysis.measure.traffic import Traffic, TrafficMeter
from robosim.analysis.measure.trips import Totals, Trip, TripLog
from robosim.analysis.measure.tunnels import Tunnels, find_tunnels
from robosim.arena.model import Arena
from robosim.envs.vector import VectorEnv
from robosim.episodes.columns import FrameColumns
from robosim.episodes.frame import Frame
from robosim.episodes.trajectory import Trajectory

CHUNK = 500
"""Decisions that are looked at together; bounds the memory, and makes numpy's calls few."""


@dataclass(frozen=True, slots=True)
class Episode:
    """All that was measured of one episode."""

    arena: Arena
    robots: int
    decisions: int
    tunnels: Tunnels
    trips: list[Trip]
    """By the decision that delivered, then by robot."""
    totals: Totals
    traffic: Traffic
    standstills: list[Clog]
    """Clogs, and standstills too short for one; by their start."""

    @property
    def seconds(self) -> float:
        """Simulated time, s."""
        return self.decisions * self.arena.timing.decision_period


class EpisodeMonitor:
    """Takes the frames of one episode, from the one after reset on, decision by decision.

    Memory grows with the events (trips, visits, clogs), with a point of every robot's track each 1.5 s, which
    the report writes, and with one of flow and density each 30 s; not with the frames.
    """

    def __init__(self, arena: Arena, robots: int, tunnels: Tunnels | None = None) -> None:
        self._arena = arena
        self._robots = robots
        self.tunnels = tunnels or find_tunnels(arena)
        self._trips = TripLog(arena, robots)
        self._traffic = TrafficMeter(arena, robots, self.tunnels)
        self.clogs = ClogFinder(arena, robots, self.tunnels)
        self._columns = FrameColumns(robots, arena.pellets.count, (arena.rows, arena.columns), CHUNK)
        self._last_step = -1
        """The last one looked at."""

    def add(self, frame: Frame) -> None:
        """Take in the next frame; ValueError unless it is that of the next decision."""
        self._check(frame.step, self._last_step + self._columns.rows + 1)
        if self._columns.add(frame):
            self.look(self._columns)
            self._columns.clear()

    def look(self, frames: FrameColumns) -> None:
        """Take in a chunk of rows at once, for those who keep columns themselves; ValueError as for `add`."""
        if frames.rows == 0:
            return
        self._check(int(frames.step[0]), self._last_step + 1)
        self._last_step = int(frames.step[frames.rows - 1])
        distance = self.tunnels.distance_to_home(frames.pose[: frames.rows, :, :2])
        self._trips.add(frames)
        self.clogs.add(frames, distance, self._traffic.add(frames, distance))

    def finish(self) -> Episode:
        """Return what was measured; the monitor takes no more frames."""
        self.look(self._columns)
        self._columns.clear()
        standstills = self.clogs.finish()
        return Episode(
            arena=self._arena,
            robots=self._robots,
            decisions=max(0, self._last_step),
            tunnels=self.tunnels,
            trips=self._trips.trips,
            totals=self._trips.totals(),
            traffic=self._traffic.finish(max(0, self._last_step)),
            standstills=standstills,
        )

    def _check(self, step: int, due: int) -> None:
        if step != due:
            raise ValueError(f"step {step} came where step {due} of the episode was due")


class TeamMonitor:
    """Watches the episodes of an evaluation: hand it to `robosim.control.evaluate.evaluate`."""

    def __init__(self) -> None:
        self.episodes: list[Episode] = []
        self.trajectories: list[Trajectory] = []
        """Seed and actions of each episode, to play it again."""
        self._monitors: list[EpisodeMonitor] = []
        self._tunnels: tuple[Arena, Tunnels] | None = None

    def begin(self, env: VectorEnv) -> None:
        """Begin to watch the episodes that have just begun."""
        if self._tunnels is None or self._tunnels[0] is not env.arena:
            self._tunnels = env.arena, find_tunnels(env.arena)
        tunnels = self._tunnels[1]
        env.world.meter()
        self._monitors = [EpisodeMonitor(env.arena, env.robots, tunnels) for _ in range(env.num_envs)]
        self.step(env)

    def step(self, env: VectorEnv) -> None:
        """Take in what a decision has led to."""
        for number, monitor in enumerate(self._monitors):
            monitor.add(env.frame(number))

    def end(self, env: VectorEnv, wanted: int) -> None:
        """Keep the first `wanted` of the episodes that are over."""
        for number, monitor in enumerate(self._monitors[:wanted]):
            self.episodes.append(monitor.finish())
            self.trajectories.append(env.trajectory(number))
        self._monitors = []


def delivered_over_time(episode: Episode) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return decisions [n] and pellets delivered by then, [n, robots], at every delivery, from (0, 0) on."""
    steps = np.array([0, *(trip.end for trip in episode.trips)], dtype=np.int64)
    counts = np.zeros((len(steps), episode.robots), dtype=np.int64)
    for row, trip in enumerate(episode.trips, 1):
        counts[row, trip.robot] = trip.pellets
    return steps, np.cumsum(counts, axis=0)
