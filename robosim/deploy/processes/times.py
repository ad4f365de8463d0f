"""How long processes wait, and when input is too old. In seconds of the world, unless said otherwise."""

from __future__ import annotations

STALE = 0.5
"""Input older than this stops a robot, and so does a wheel command that is (as on the Robotarium)."""
MAP_STALE = 2.0
"""A robot that has read nothing of the pheromone map for so long stops."""
GRACE = 0.4
"""Share of a control period for which the service waits for deposits that are missing."""
PATIENCE = 0.7
"""Share of a control period for which a robot waits for its reading of the map."""
FRAME_PATIENCE = 0.35
"""Share of a control period for which a robot that has its pose waits for what else belongs to it."""
SLOWEST_GRACE, SLOWEST_PATIENCE, SLOWEST_FRAME = 0.2, 0.35, 0.4
"""The same where the world goes as fast as all answer, s of the wall clock."""
HEARTBEAT = 0.1
"""Longest time between two messages of a process that lives, s of the wall clock."""
GONE = 1.0
"""A world that is silent for so long may be followed by another one, s of the wall clock."""
TAKEOVER = 4.0
"""So long a process waits for another one under its name to go, s of the wall clock."""


def scale(speed: float) -> float:
    """Return how many seconds of the world limits count in one of the wall clock."""
    return speed or 1.0


def grace(control_period: float, speed: float) -> float:
    """Return how long the service waits for deposits, s of the wall clock."""
    return GRACE * control_period / speed if speed else SLOWEST_GRACE


def patience(control_period: float, speed: float) -> float:
    """Return how long a robot waits for its reading, s of the wall clock."""
    return PATIENCE * control_period / speed if speed else SLOWEST_PATIENCE


def frame_patience(control_period: float, speed: float) -> float:
    """Return how long a robot that has its pose waits for the rest, s of the wall clock."""
    return FRAME_PATIENCE * control_period / speed if speed else SLOWEST_FRAME
