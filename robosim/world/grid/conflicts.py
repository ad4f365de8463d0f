"""Who moves: all robots decide at once, and this says which of their moves are possible together.

The rules, in the order in which they are applied:

1. A move into a wall is refused.
2. Two robots that want to exchange their cells cannot pass each other: both are refused.
3. Of several robots that want one cell, the one that comes last in the decision's order may have it; the
   others are refused. The order is drawn anew for every decision, so nobody is favoured.
4. A robot moves if its cell is empty, or becomes empty in the same decision. So a column moves as one, and
   so do four robots and more in a circle, each into the cell that the next one leaves. Where the robot at
   the head of a column cannot move, the whole column stands.

Nobody's outcome depends on a robot's number: relabelled robots with a relabelled order have a relabelled
outcome. The outcome is the one with the most moves that these rules allow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

FORBIDDEN = 0
"""A cell that nobody can want: the corner of the map's border, which is wall."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What comes of the robots' wishes; arrays are [envs, robots]."""

    moved: Bools
    walled: Bools
    """Was refused by a wall."""
    met: Bools
    """Was refused by a robot: the one that is in the wanted cell now."""


class Crowd:
    """Which robot is in which cell of which environment, and who may move."""

    def __init__(self, free: Bools, num_envs: int, robots: int) -> None:
        """`free` [cells] says which cells are no walls; its first and last cells belong to the border."""
        self._free = free
        self._robots = robots
        cells = len(free)
        self.first_cell = cells * np.arange(num_envs)[:, None]
        """[envs, 1] where an environment's cells begin in flat arrays [envs * cells]."""
        # One more robot than there are, which is nobody: it is in no cell, wants none and never stands still.
        self._first_robot = (robots + 1) * np.arange(num_envs)[:, None]
        self._nobody = self._first_robot + robots
        self._number = self._first_robot + np.arange(robots)
        self._occupant = np.repeat(self._nobody, cells, axis=1).ravel()
        self._claim = np.zeros(num_envs * cells, dtype=np.int64)
        self._target = np.full((num_envs, robots + 1), -1)
        self._stands = np.zeros((num_envs, robots + 1), dtype=np.bool_)
        self._jump = np.empty((num_envs, robots + 1), dtype=np.int64)
        self._passes = (robots - 1).bit_length()
        """Each pass looks twice as far ahead along a column of robots."""

    def place(self, cell: Integers) -> None:
        """Put the robots into cells [envs, robots], each into one of its own."""
        self._occupant.reshape(len(cell), -1)[...] = self._nobody
        self._occupant[cell + self.first_cell] = self._number

    def occupant(self, env: Integers, cell: Integers) -> Integers:
        """Return which robots are in cells, or the number of robots where nobody is; any shape."""
        flat = self._occupant.take(env * len(self._free) + cell)
        return np.asarray(flat - self._first_robot[env, 0])

    def move(self, cell: Integers, target: Integers, order: Integers) -> Outcome:
        """Let robots in `cell` go to `target`, a neighbour or their own cell, as far as the rules allow.

        All are [envs, robots]. `order` lists the robots of each environment: of those who want the same cell
        the last one in it has precedence.
        """
        wants = target != cell
        walled = ~self._free.take(target)
        wishes = wants & ~walled
        ahead = self._occupant.take(target + self.first_cell)
        own = self._target[:, :-1]
        own[...] = target
        wishes &= self._target.take(ahead) != cell
        claimed = np.where(wishes, target, FORBIDDEN) + self.first_cell
        # Where several write to one cell, what is written last stays.
        in_order = order + self._first_robot
        turn = order + self._robots * np.arange(len(order))[:, None]
        self._claim[claimed.take(turn)] = in_order
        goes = wishes & (self._claim.take(claimed) == self._number)
        waits_for = ahead != self._nobody
        waits_for &= goes
        if np.count_nonzero(waits_for):
            goes = self._unblocked(goes, ahead)
        here, there = cell + self.first_cell, np.where(goes, target, cell) + self.first_cell
        self._occupant[here] = self._nobody
        self._occupant[there] = self._number
        walled &= wants
        return Outcome(moved=goes, walled=walled, met=wants & ~walled & ~goes)

    def _unblocked(self, goes: Bools, ahead: Integers) -> Bools:
        """Return who of those who may go has nobody ahead that stands, however long the column."""
        stands, jump = self._stands, self._jump
        np.logical_not(goes, out=stands[:, :-1])
        jump[:, :-1] = ahead
        jump[:, -1:] = self._nobody
        for _ in range(self._passes):
            stands |= stands.take(jump)
            jump = jump.take(jump)
        return ~stands[:, :-1]
