"""The pheromone map as a robot sees it that keeps none: a deposit goes out, a reading comes back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.deploy.link.messages import NORTH_UP, Deposit, Reading, patch_numbers
from robosim.discretise.cells import Grid
from robosim.discretise.pheromone import QUARTERS, PheromoneConfig
from robosim.robot.drivers import STOP

Integers = NDArray[np.int64]


class RemoteMap:
    """Keeps `robosim.discretise.pheromone.SharedMemory` for one robot of a team.

    Once in a decision `exchange` is given the robot's deposit, and returns what has been read around it, or
    None where no reading came in time; then the last one counts. What others of the team would read is 0.
    """

    def __init__(
        self,
        arena: Arena,
        config: PheromoneConfig,
        robot: int,
        exchange: Callable[[Deposit], Reading | None],
    ) -> None:
        self._grid = Grid(arena, margin=max(config.radius, 1))
        self._robot = robot
        self._exchange = exchange
        self.decision = 0
        """Of the world's clock; whoever drives sets it before each."""
        self._marks: tuple[int, bool, int] | None = None
        self._marked = 0
        """The cell that the robot was in as it left its marks, as in `update`."""
        self._exchanged = -1
        self._patch = np.zeros(patch_numbers(config.radius), np.float32)
        self._density = 0.0

    @property
    def patch_size(self) -> int:
        return len(self._patch)

    def reset(self) -> None:
        """Forget what has been read, and leave no marks for the next decision."""
        self._marks = None
        self._exchanged = -1
        self._patch[...] = 0.0
        self._density = 0.0

    def update(
        self, cell: Integers, mode: NDArray[np.uint8], laden: NDArray[np.bool_], action: Integers
    ) -> None:
        """Remember the robot's marks until it reads; arguments are [1, robots]."""
        mine = 0, self._robot
        self._marks = int(mode[mine]), bool(laden[mine]), int(action[mine])
        self._marked = int(cell[mine])

    def deposit(self) -> Deposit | None:
        """Return the newest marks, as a robot sends them that reads nothing; None before the first."""
        return None if self._marks is None else self._deposit(self._marked, NORTH_UP)

    def read(
        self, cell: Integers, out: NDArray[np.float32], heading: NDArray[np.float64] | None = None
    ) -> None:
        """Write the patch around the robot into its row of `out` [1, robots, patch_size]."""
        facing = NORTH_UP
        if heading is not None:
            facing = int(np.rint(heading[0, self._robot] * (2.0 / np.pi))) % QUARTERS
        self._ask(cell, facing)
        out[...] = 0.0
        out[0, self._robot] = self._patch

    def tunnel_density(self, cell: Integers) -> NDArray[np.float64]:
        """Return the density that was last told, [1]."""
        self._ask(cell, NORTH_UP)
        return np.array([self._density])

    def _ask(self, cell: Integers, facing: int) -> None:
        if self._exchanged == self.decision:
            return
        self._exchanged = self.decision
        reading = self._exchange(self._deposit(int(cell[0, self._robot]), facing))
        if reading is not None and len(reading.patch) == len(self._patch):
            self._patch, self._density = reading.patch, reading.density

    def _deposit(self, cell: int, facing: int) -> Deposit:
        row, column = divmod(cell, self._grid.shape[1])
        margin = self._grid.margin
        mode, laden, action = self._marks or (0, False, STOP)
        return Deposit(
            decision=self.decision,
            column=column - margin,
            row=row - margin,
            facing=facing,
            marks=self._marks is not None,
            mode=mode,
            laden=laden,
            action=action,
        )
