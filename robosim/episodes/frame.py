"""What a recorder or a report reads of one environment at one decision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.equality import EqualByValue
from robosim.world.contacts import Contacts


@dataclass(frozen=True, slots=True, eq=False)
class Frame(EqualByValue):
    """One environment at one decision. Arrays are views into the environment: copy what you keep."""

    step: int
    """Decision within the episode, 0 after reset."""
    time: float
    """s."""
    pose: NDArray[np.float64]
    """[robots, 3] x m, y m, heading rad."""
    mode: NDArray[np.uint8]
    """[robots] `Mode`; COLLISION overlays the others."""
    laden: NDArray[np.bool_]
    """[robots] holds a pellet."""
    action: NDArray[np.int64]
    """[robots] action taken that led here (4 after reset)."""
    reward: NDArray[np.float32]
    """[robots]; NaN where nobody works them out."""
    pellets: NDArray[np.float64]
    """[pellets, 2] m."""
    pellet_status: NDArray[np.uint8]
    """[pellets] 0 loose, 1 held, 2 absent (waiting for room in the source)."""
    delivered: NDArray[np.int64]
    """[robots] pellets delivered in this episode so far."""
    energy: NDArray[np.float64]
    """[robots] J lost at the wheels in this episode so far; 0 unless the world meters it."""
    closest: NDArray[np.float64]
    """[robots] m, the least distance to another robot's centre in this episode so far; infinite for one
    alone, and unless the world meters it."""
    density: float
    """Robots per tunnel cell of length, n / L."""
    pheromone: NDArray[np.float64]
    """[rows, columns] occupancy, row 0 at the bottom."""
    contacts: Contacts
    """Of this decision."""
