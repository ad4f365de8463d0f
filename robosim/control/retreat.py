"""Robots that have come to a stand retreat: a rule beside the networks of a policy.

Robots that meet head-on in a narrow tunnel, or press one another into a corner, stay as they are if each goes
on to where it wants to be, however it draws: a step back is undone in the next decision. So in every decision
one of ten robots that have stood for a while begins to retreat, and does so for long enough that others can
pass or turn. It is the only part of a policy that remembers anything from one decision to the next.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.observation import Columns, MoveGains, blocked_moves, standing
from robosim.errors import InputError

CHANCE = 0.1
"""Of a robot that has stood for a while, in every decision, to begin to retreat."""
FINE = 4096.0
"""An action is drawn by the first digits of a draw, and a retreat by those behind: it times this, less the
whole part of that. All of it is exact in float32."""

Floats = NDArray[np.float32]
Whole = NDArray[np.int64]


class Known(NamedTuple):
    """Where an observation holds what robots retreat by, as in `Columns`."""

    gains: MoveGains
    in_place: int
    laden: int


class RetreatDecisions(NamedTuple):
    """For how many decisions a robot retreats once it begins to."""

    without_pellet: int
    with_pellet: int


def known_for_retreats(columns: Columns) -> Known | None:
    """Return that; None where an observation does not hold all of it."""
    gains, in_place, laden = columns
    return None if gains is None or in_place is None or laden is None else Known(gains, in_place, laden)


def checked_retreats(retreats: Whole | None, shape: tuple[int, ...], place: str = "") -> Whole:
    """Return the array of decisions that are left; InputError, which begins with `place`, for any other."""
    if retreats is None or retreats.shape != shape or retreats.dtype != np.int64:
        given = "missing" if retreats is None else f"of type {retreats.dtype} and shape {retreats.shape}"
        raise InputError(
            f"{place}retreats is {given}, but must be an array of int64 and shape {shape}: these robots "
            "retreat, and it holds for how many decisions yet."
        )
    return retreats


class Retreat:
    """Replaces the actions of robots that retreat."""

    def __init__(self, known: Known, decisions: RetreatDecisions) -> None:
        """Take by what robots retreat, and for how many `decisions`."""
        self._gains, self._in_place, self._laden = known
        self._decisions = decisions

    def __call__(self, actions: Whole, observation: Floats, drawn: Floats, left: Whole) -> Whole:
        """Return the `actions` [..., robots], those of retreating robots replaced by a move.

        `drawn` [..., robots] are the draws of the decision. `left` [..., robots] holds for how many decisions
        each robot retreats yet, and is changed in place.
        """
        laden = observation[..., self._laden] >= np.float32(0.5)
        stands = standing(observation, self._in_place)
        fine = drawn * np.float32(FINE)
        begins = stands & (left == 0) & (fine - np.floor(fine) < np.float32(CHANCE))
        without_pellet, with_pellet = self._decisions
        left[begins] = np.where(laden, with_pellet, without_pellet)[begins]
        retreats = left > 0
        left[retreats] -= 1
        return np.where(retreats, self._move(observation, laden, actions), actions)

    def _move(self, observation: Floats, laden: NDArray[np.bool_], otherwise: Whole) -> Whole:
        """Return the open move that leads away from a robot's goal the most, the first among equals.

        That is toward the source with a pellet, home without; where no move is open, the action `otherwise`.
        """
        home, source, moves = self._gains
        away = np.where(
            laden[..., None], observation[..., source : source + moves], observation[..., home : home + moves]
        )
        blocked = np.asarray(blocked_moves(observation, self._gains), np.bool_)
        best: Whole = np.where(blocked, -np.inf, away).argmax(axis=-1)
        return np.where(blocked.all(axis=-1), otherwise, best)
