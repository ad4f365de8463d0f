"""Sensing: what robots perceive of the world, between its state and all that they do.

Modes, pheromones and observations come from the percept; rewards and metrics come from the state itself.
A sensor that adds noise, delay or loss takes the place of `ExactSensor`, and nothing else changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from robosim.world.state import WorldState

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Percept(NamedTuple):
    """What the robots of a batch of worlds perceive; arrays are valid until the next decision."""

    pose: Floats
    """[envs, robots, 3] x m, y m, heading rad."""
    laden: Bools
    """[envs, robots] holds a pellet."""
    at_pellet: Bools
    """[envs, robots] the gripper touches a loose pellet."""
    touched: Bools
    """[3, envs, robots] touched another robot, a wall, a loose pellet in the last decision."""
    refused: Bools
    """[envs, robots] a move onto a cell was refused, and none has succeeded since."""
    nearest: NDArray[np.int64]
    """[envs, robots] the pellet nearest to the gripper; a loose one if there is any."""
    pellets: Floats
    """[envs, pellets, 2] m."""
    pellet_status: NDArray[np.uint8]
    """[envs, pellets] `PelletStatus`."""


class Sensor(Protocol):
    """Turns the states of a batch of worlds into percepts."""

    age: Floats
    """[envs, robots] decisions since the last percept's poses were measured; a lone 0 where all are fresh."""

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Begin an episode in every environment; what is random in it comes from its one of `seeds`."""
        ...

    def sense(self, state: WorldState) -> Percept:
        """Return what is perceived of `state`, once in a decision."""
        ...


class ExactSensor:
    """Perceives the world as it is; its percept's pose is the state's own array."""

    age = np.zeros(())

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Nothing is remembered and nothing is random."""

    def sense(self, state: WorldState) -> Percept:
        return Percept(
            state.pose,
            state.held >= 0,
            state.touching >= 0,
            state.touched,
            state.refused,
            state.nearest,
            state.pellets,
            state.pellet_status,
        )
