"""What a physical world asks of the engine that moves its bodies."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Bodies(Protocol):
    """The bodies of one environment during one episode: `EpisodeSpace` in pymunk, or those of another engine.

    The world keeps the rules (who may take which pellet, what is delivered, where fresh pellets lie); the
    engine moves bodies, and says where they are and what touches. It is handed an array of commands
    [robots, 3], which `drive` and `drive_substep` read.
    """

    body_ids: NDArray[np.uintp]
    """[robots + pellets] ids that no body of another environment has, robots first."""
    ground_id: np.uintp
    """The id of what does not move."""

    def drive(self) -> None:
        """Hold the commands for one control period."""
        ...

    def drive_substep(self) -> None:
        """Hold the commands for one substep."""
        ...

    def advance(self) -> None:
        """Run the solver for one control period."""
        ...

    def poses(self) -> Floats:
        """Return x, y, angle, [n, 3], robots first."""
        ...

    def bodies(self) -> tuple[NDArray[np.uintp], Floats]:
        """Return ids [n] and x, y, angle, vx, vy, rate [n, 6], robots first."""
        ...

    def forget_contacts(self) -> None:
        """Begin a new list of contacts."""
        ...

    def list_contacts(self) -> int:
        """Append the last control period's contacts to the list; returns its length."""
        ...

    def contacts(self) -> tuple[NDArray[np.uintp], Floats]:
        """Return the list: body ids [n, 2], and impulse x, y, point x, y [n, 4]."""
        ...

    def grip(self, robot: int, pellet: int) -> tuple[float, float]:
        """Let a robot hold a pellet where it is; returns its place in the robot's frame, m."""
        ...

    def release(self, pellet: int) -> None:
        """Let a held pellet drop to the ground where it is."""
        ...

    def place(self, pellet: int, place: Floats, velocity: tuple[float, float] = (0.0, 0.0)) -> None:
        """Put a pellet to a place, at rest or moving (m/s); an absent one comes back."""
        ...

    def take_out(self, pellet: int) -> None:
        """Remove a loose pellet until `place` brings it back."""
        ...

    def cohere(self, touching: Integers, positions: Floats) -> None:
        """Let touching pellets [n, 2] hold together; `positions` [pellets, 2] in m."""
        ...
