"""What a script draws is projected onto the laboratory's floor: pheromones, walls, pellets and the score."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Zone
from robosim.deploy.robotarium.experiment import Experiment
from robosim.world.state import HELD, LOOSE

_TINTS = {
    Zone.WALL: (0.35, 0.35, 0.38, 1.0),
    Zone.HOME: (0.55, 0.75, 0.55, 0.5),
    Zone.SOURCE: (0.85, 0.7, 0.45, 0.5),
}
_LOOSE, _HELD = "saddlebrown", "crimson"


class Picture:
    """Drawn once, and then only what has changed: in decisions, since nothing else changes it."""

    def __init__(self, axes: Any, experiment: Experiment) -> None:
        """Draw on the laboratory's `axes`, of matplotlib."""
        self._experiment = experiment
        arena = experiment.team.arena
        (left, bottom), (width, height) = experiment.origin[:2], arena.size
        extent = (left, left + width, bottom, bottom + height)
        limits = axes.get_xlim(), axes.get_ylim()
        zones = np.zeros((*arena.zones.shape, 4))
        for zone, tint in _TINTS.items():
            zones[arena.zones == zone] = tint
        common = {"extent": extent, "origin": "lower", "interpolation": "nearest"}
        self._marks = axes.imshow(
            self._occupancy(), cmap="Blues", vmin=0.0, vmax=1.0, alpha=0.8, zorder=-2, **common
        )
        axes.imshow(zones, zorder=-1, **common)
        self._loose = axes.scatter([], [], s=12, color=_LOOSE, zorder=0)
        self._held = axes.scatter([], [], s=40, color=_HELD, zorder=5)
        self._score = axes.text(
            left + 0.5 * width, bottom + 0.97 * height, "", ha="center", va="top", color="white", zorder=6
        )
        # An image would take the axes for its own.
        axes.set_xlim(limits[0])
        axes.set_ylim(limits[1])
        axes.set_aspect("equal")

    def draw(self) -> None:
        """Bring marks, pellets and score up to date."""
        floor = self._experiment.floor
        place = floor.pellets + self._experiment.origin[:2]
        self._marks.set_data(self._occupancy())
        self._loose.set_offsets(place[floor.status == LOOSE])
        self._held.set_offsets(place[floor.status == HELD])
        self._score.set_text(f"{floor.delivered.sum()} pellets")

    def _occupancy(self) -> NDArray[np.float64]:
        """Return the marks as shares of saturation, [rows, columns]."""
        team = self._experiment.team
        pheromone = team.settings["pheromone"]
        return np.asarray(team.driven.occupancy * (pheromone["decay"] / pheromone["reinforcement"]))
