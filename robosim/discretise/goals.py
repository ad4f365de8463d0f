"""Where each robot brings pellets and where it takes them, and how far away that is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import GOALS, Arena, Zone
from robosim.robot.team import Role, Team

Floats = NDArray[np.float64]


class Goals:
    """Distances of robots to their own goals; for those that do all the work, to home and source."""

    def __init__(self, arena: Arena, team: Team) -> None:
        self._distances = arena.distances
        self._handover = None if team.all_round else arena.handover
        self._handed = np.array([goals_handed(Role(role)) for role in team.role])
        farthest = float(arena.distances.raster.max())
        if self._handover is not None:
            farthest = max(farthest, float(self._handover.raster.max()))
        self.farthest = farthest
        """The largest distance in the arena, m."""

    def sample(self, places: Floats) -> Floats:
        """Return the distances [envs, robots, ..., 2] in m (to bring, to take) at `places` of that shape."""
        distances = self._distances.sample(places)
        if self._handover is None:
            return distances
        robots = len(self._handed)
        handed = self._handed.reshape(robots, *(1,) * (places.ndim - 3), 2)
        return np.where(handed, self._handover.sample(places), distances)


def goals_handed(role: Role) -> tuple[bool, bool]:
    """Return whether the hand-over is where robots of a role bring pellets, and where they take them."""
    brings, takes = GOALS[role]
    return brings == Zone.HANDOVER, takes == Zone.HANDOVER


def distances_of(role: Role, arena: Arena, places: Floats) -> Floats:
    """Return the distances [..., 2] in m of robots of a role to their goals (to bring, to take)."""
    distances = arena.distances.sample(places)
    if arena.handover is None:
        return distances
    return np.where(goals_handed(role), arena.handover.sample(places), distances)
