"""The pheromone map of a team, as its service keeps it: the same code as in training, tick by tick.

A tick is a decision of the world's clock. The marks of all robots for a decision are left together, as in
training. Those that come after their tick are left as they come.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.deploy.link.messages import NORTH_UP, Deposit, Reading, patch_numbers
from robosim.discretise.cells import Grid
from robosim.discretise.pheromone import QUARTERS, PheromoneMap
from robosim.envs.config import EnvConfig
from robosim.errors import InputError, refused
from robosim.files import ARCHIVE_DAMAGE, is_regular, write_whole

Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

NOT_BEGUN = -1
MOST_RADIUS = 60
"""Cells; what is read around a robot then takes 234 kB, of the 262 kB that a message may have."""
MOST_MISSED = 2000
"""Ticks that are made up for at once; after so many nothing is left to decay."""
_FORMAT = "robosim pheromone map, version 1"
_MOST_FILE = 50_000_000
"""Bytes."""


class SharedMap:
    """Takes deposits, and ticks."""

    def __init__(self, config: EnvConfig, arena: Arena, setup: int) -> None:
        """Begin with an empty map; `setup` goes into its file, and must be the same where that is read.

        InputError for a field of view that does not fit a message.
        """
        constants, layout = config.pheromone, config.layout_in(arena)
        if constants.radius > MOST_RADIUS:
            raise refused("pheromone radius", constants.radius, f"at most {MOST_RADIUS}, to fit a message")
        self._grid = Grid(arena, margin=max(constants.radius, 1))
        self._map = PheromoneMap(self._grid, 1, constants, layout.num_actions)
        self._map.reset()
        self._radius = constants.radius
        self._actions = layout.num_actions
        self._setup = setup
        self.decision = NOT_BEGUN
        """Of the last tick."""
        self._waiting: dict[int, Deposit] = {}
        self._cells: dict[int, int] = {}
        """Where each robot was when it was last heard, by the grid's flat index."""

    @property
    def occupancy(self) -> NDArray[np.float32]:
        """[rows, columns]."""
        return np.asarray(self._map.occupancy[0], np.float32)

    def begin(self) -> None:
        """Begin anew, with an empty map."""
        self._map.reset()
        self.decision = NOT_BEGUN
        self._waiting.clear()
        self._cells.clear()

    def deposit(self, robot: int, deposit: Deposit) -> str:
        """Take a robot's deposit for its tick, or leave its marks now if that is over.

        Returns why it is dropped, or nothing.
        """
        if deposit.action >= self._actions:
            return "unknown action"
        if not (deposit.column < self._grid.columns and deposit.row < self._grid.rows):
            return "off the map"
        waiting = self._waiting.get(robot)
        if waiting is not None and waiting.decision >= deposit.decision:
            return "of a decision that is past"
        margin = self._grid.margin
        self._cells[robot] = (deposit.row + margin) * self._grid.shape[1] + deposit.column + margin
        if not self.late(deposit):
            self._waiting[robot] = deposit
        elif deposit.marks:
            self._map.mark(*self._arrays({robot: deposit}))
        return ""

    def late(self, deposit: Deposit) -> bool:
        """Return whether the tick of a deposit is over."""
        return deposit.decision <= self.decision

    @property
    def next_decision(self) -> int:
        """The latest decision that somebody waits for; `NOT_BEGUN` if nobody does."""
        return max((one.decision for one in self._waiting.values()), default=NOT_BEGUN)

    def forget(self, robot: int) -> None:
        """Count a robot no longer: its process has gone."""
        self._cells.pop(robot, None)

    def has_all(self, robots: list[int], decision: int) -> bool:
        """Return whether these robots have all sent their deposits of a decision."""
        return all(one in self._waiting and self._waiting[one].decision >= decision for one in robots)

    def tick(self, decision: int) -> dict[int, Reading]:
        """Advance to a later decision; return what each robot that has sent a deposit reads.

        Ticks that were missed are made up for, without marks. The first one finds the map as it is.
        """
        deposits = dict(sorted(self._waiting.items()))
        if self.decision != NOT_BEGUN:
            self._leave({}, min(decision - self.decision - 1, MOST_MISSED))
            self._leave({robot: one for robot, one in deposits.items() if one.marks}, 1)
        self.decision = decision
        self._waiting.clear()
        return {robot: self.read(robot, deposit) for robot, deposit in deposits.items()}

    def _leave(self, deposits: dict[int, Deposit], ticks: int) -> None:
        arrays = self._arrays(deposits)
        for _ in range(ticks):
            self._map.update(*arrays)

    def _arrays(self, deposits: dict[int, Deposit]) -> tuple[Integers, Bytes, Bools, Integers]:
        """Return cells, modes, loads and actions, [1, deposits] each."""
        robots = list(deposits)
        cell = np.array([[self._cells[robot] for robot in robots]], np.int64)
        mode = np.array([[deposits[robot].mode for robot in robots]], np.uint8)
        laden = np.array([[deposits[robot].laden for robot in robots]], np.bool_)
        action = np.array([[deposits[robot].action for robot in robots]], np.int64)
        return cell, mode, laden, action

    def read(self, robot: int, deposit: Deposit) -> Reading:
        """Return what is around a robot."""
        patch = np.empty((1, 1, patch_numbers(self._radius)), np.float32)
        cell = np.array([[self._cells[robot]]], np.int64)
        facing = deposit.facing
        heading = None if facing == NORTH_UP else np.array([[facing * 2.0 * np.pi / QUARTERS]])
        self._map.read(cell, patch, heading)
        everybody = np.array([list(self._cells.values())], np.int64)
        density = float(self._map.tunnel_density(everybody)[0])
        return Reading(max(self.decision, 0), self._radius, density, patch[0, 0])

    def save(self, path: Path, world: int) -> None:
        """Write the map to a file, whole or not at all; `world` is the instance whose run it is of.

        InputError if it cannot be written.
        """
        data = io.BytesIO()
        np.savez(
            data,
            format=np.array(_FORMAT),
            setup=np.array([self._setup], np.uint64),
            world=np.array([world], np.uint64),
            decision=np.array([self.decision], np.int64),
            values=self._map.values,
        )
        write_whole(path, data.getvalue())

    def restore(self, path: Path) -> int:
        """Take over the map that a file holds; return the instance of the world whose run it is of.

        InputError for anything that is not a saved map of this arena, team and pheromones.
        """
        world, decision, values = _read_saved(path, self._setup)
        shape = self._map.values.shape
        if values.shape != shape or not np.isfinite(values).all() or (values < 0.0).any():
            raise InputError(f"{path}: not a whole map; remove the file to begin with an empty one.")
        self._map.restore(values)
        self.decision = decision
        self._waiting.clear()
        self._cells.clear()
        return world


def _read_saved(path: Path, setup: int) -> tuple[int, int, NDArray[np.float64]]:
    wrong = InputError(f"{path}: not a saved pheromone map; give another file, or remove this one.")
    if not is_regular(path) or path.stat().st_size > _MOST_FILE:
        raise wrong
    try:
        # Without pickles nothing in the file can run.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as saved:
            if str(saved["format"]) != _FORMAT:
                raise wrong
            numbers = [int(saved[name][0]) for name in ("setup", "world", "decision")]
            values = np.asarray(saved["values"], np.float64)
    except (OSError, *ARCHIVE_DAMAGE):
        raise wrong from None
    if numbers[0] != setup:
        raise InputError(
            f"{path}: of another arena, team or pheromones; give another file, or remove this one."
        )
    return numbers[1], max(numbers[2], NOT_BEGUN), values
