"""The pellets of the grid: points in cells, taken by the robot that is in their cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.world.grid.layout import cells_at
from robosim.world.state import ABSENT, HELD, LOOSE, WorldState

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

NOWHERE = -1


class PelletStore:
    """Moves pellets between source, robots and home; everything it changes is in the state that it is given.

    Two robots are never in one cell, so no two ever reach for the same pellet.
    """

    def __init__(self, arena: Arena, state: WorldState) -> None:
        self._state = state
        envs, count = state.pellet_status.shape
        self._places = arena.pellet_places
        self._cell_of_place = cells_at(arena, arena.pellet_places)
        self._home = (arena.zones == Zone.HOME).ravel()
        self._cells = cells = arena.zones.size
        self._first_cell = cells * np.arange(envs)[:, None]
        # A place taken as far away as can be is never the nearest one.
        self._x = np.full((envs, 1, count), np.inf)
        self._y = np.full((envs, 1, count), np.inf)
        self._cell = np.full((envs, count), NOWHERE)
        """[envs, pellets] the cell of a loose pellet."""
        self._spot = np.full((envs, count), NOWHERE)
        """[envs, pellets] the place of the source where a loose pellet has lain since it was put there."""
        self._open = np.ones((envs, len(self._places)), dtype=np.bool_)
        """[envs, places] where no pellet lies."""
        self._in_cell = np.zeros(envs * cells, dtype=np.int64)
        """[envs * cells] loose pellets."""

    def reset(self, spots: Integers) -> None:
        """Begin an episode with loose pellets at rows `spots` [envs, pellets] of the places."""
        self._open.fill(True)
        self._in_cell.fill(0)
        self._state.pellets[...] = self._places[spots]
        env, pellet = np.indices(spots.shape).reshape(2, -1)
        self._lay(env, pellet, self._cell_of_place[spots].ravel())
        self._spot[...] = spots
        self._open[env, spots.ravel()] = False

    def carry(self, nose: Floats) -> None:
        """Bring the held pellets to the noses [envs, robots, 2] of their holders."""
        env, robot = np.nonzero(self._state.held >= 0)
        if len(env):
            self._state.pellets[env, self._state.held[env, robot]] = nose[env, robot]

    def drop(self, opened: Bools, cell: Integers) -> None:
        """Let go of what laden robots `opened` hold: in the home it is delivered, elsewhere it lies there."""
        state = self._state
        env, robot = np.nonzero(opened)
        pellet, at = state.held[env, robot], cell[env, robot]
        state.held[env, robot] = -1
        home = self._home.take(at)
        state.deliveries[env[home], robot[home]] = 1
        state.delivered += state.deliveries.sum(axis=1)
        state.pellet_status[env[home], pellet[home]] = ABSENT
        if np.count_nonzero(home) < len(home):
            self._lay(env[~home], pellet[~home], at[~home])

    def refill(self, cell: Integers, chance: Floats) -> None:
        """Put waiting pellets to random places of the source with neither pellet nor robot in reach.

        `cell` and `chance`, numbers from [0, 1), are [envs, robots]: at most one pellet a robot comes back in
        a decision. Where there is no place, pellets wait on.
        """
        state = self._state
        waiting = state.pellet_status == ABSENT
        left = np.minimum(waiting.sum(axis=1), cell.shape[1])
        for turn in range(int(left.max(initial=0))):
            env = np.flatnonzero(left > turn)
            # Nobody finds a pellet under its wheels: a cell that a robot is in stays as it is.
            vacant = np.ones((len(env), self._cells), dtype=np.bool_)
            vacant[np.arange(len(env))[:, None], cell[env]] = False
            rank = np.cumsum(self._open[env] & vacant.take(self._cell_of_place, axis=1), axis=1)
            room = rank[:, -1] > 0
            env, rank = env[room], rank[room]
            if not len(env):
                return
            wanted = (chance[env, turn] * rank[:, -1]).astype(np.int64)
            spot = (rank > wanted[:, None]).argmax(axis=1)
            pellet = waiting[env].argmax(axis=1)
            waiting[env, pellet] = False
            state.pellets[env, pellet] = self._places[spot]
            self._lay(env, pellet, self._cell_of_place[spot])
            self._spot[env, pellet] = spot
            self._open[env, spot] = False
            state.refilled[env] += 1
            state.fresh[env, pellet] = True

    def take(self, takers: Bools, cell: Integers) -> Integers:
        """Let `takers` [envs, robots] take what they touch; returns the environments concerned."""
        state = self._state
        env, robot = np.nonzero(takers)
        pellet = state.touching[env, robot]
        state.held[env, robot] = pellet
        state.picked[env, robot] = pellet
        state.pellet_status[env, pellet] = HELD
        self._x[env, 0, pellet] = self._y[env, 0, pellet] = np.inf
        self._cell[env, pellet] = NOWHERE
        self._in_cell[(cell + self._first_cell)[env, robot]] -= 1
        spot = self._spot[env, pellet]
        self._open[env[spot >= 0], spot[spot >= 0]] = True
        self._spot[env, pellet] = NOWHERE
        return np.flatnonzero(takers.any(axis=1))

    def feel(self, cell: Integers, nose: Floats) -> None:
        """Find each robot's nearest loose pellet, first in its own cell, where it touches it; then anywhere.

        `cell` is [envs, robots], `nose` [envs, robots, 2] m, from which distances count.
        """
        self._feel(slice(None), cell, nose)

    def feel_again(self, envs: Integers, cell: Integers, nose: Floats) -> None:
        """Do what `feel` does, for some of the environments only."""
        self._feel(envs, cell[envs], nose[envs])

    def _feel(self, envs: Integers | slice, cell: Integers, nose: Floats) -> None:
        state = self._state
        if not state.pellet_status.size:
            return
        apart = self._x[envs] - nose[..., 0, None]
        apart *= apart
        across = self._y[envs] - nose[..., 1, None]
        across *= across
        apart += across
        nearest = apart.argmin(axis=2)
        touching = np.full(cell.shape, -1)
        here = cell + self._first_cell[envs]
        env, robot = np.nonzero(self._in_cell.take(here))
        if len(env):
            same = self._cell[envs][env] == cell[env, robot][:, None]
            own = np.where(same, apart[env, robot], np.inf).argmin(axis=1)
            nearest[env, robot] = own
            touching[env, robot] = np.where(state.held[envs][env, robot] < 0, own, -1)
        state.nearest[envs] = nearest
        state.touching[envs] = touching

    def _lay(self, env: Integers, pellet: Integers, cell: Integers) -> None:
        """Make pellets loose in cells, at the places that the state has of them; all are [n]."""
        state = self._state
        state.pellet_status[env, pellet] = LOOSE
        self._x[env, 0, pellet], self._y[env, 0, pellet] = state.pellets[env, pellet].T
        self._cell[env, pellet] = cell
        np.add.at(self._in_cell, self._first_cell[env, 0] + cell, 1)
