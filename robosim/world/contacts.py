"""Contacts between bodies, as flat arrays."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from robosim.equality import EqualByValue


class ContactKind(IntEnum):
    """What touched; a pellet that a robot holds counts as a part of that robot."""

    ROBOT_ROBOT = 0
    ROBOT_WALL = 1
    ROBOT_PELLET = 2


@dataclass(frozen=True, slots=True, eq=False)
class Contacts(EqualByValue):
    """The contacts of one decision: pairs of bodies that press on each other as a control period ends."""

    env: NDArray[np.int64]
    """[n] environment."""
    time: NDArray[np.float64]
    """[n] end of the control period since the episode began, s."""
    kind: NDArray[np.uint8]
    """[n] `ContactKind`."""
    a: NDArray[np.int64]
    """[n] robot."""
    b: NDArray[np.int64]
    """[n] the other robot, the pellet, or -1 for a wall."""
    position: NDArray[np.float64]
    """[n, 2] m."""
    impulse: NDArray[np.float64]
    """[n] N s, in the last substep of the control period; over the length of a substep it gives the force.
    NaN in a world that knows no forces."""

    def of_env(self, env: int) -> Contacts:
        """Return the contacts of one environment."""
        return self.where(self.env == env)

    def where(self, mask: NDArray[np.bool_]) -> Contacts:
        """Return the contacts that `mask` [n] selects."""
        return Contacts(
            self.env[mask],
            self.time[mask],
            self.kind[mask],
            self.a[mask],
            self.b[mask],
            self.position[mask],
            self.impulse[mask],
        )


def no_contacts() -> Contacts:
    """Return an empty record."""
    whole = np.empty(0, dtype=np.int64)
    real = np.empty(0)
    return Contacts(whole, real, np.empty(0, dtype=np.uint8), whole, whole, np.empty((0, 2)), real)


def onsets(
    pair: NDArray[np.int64], time: NDArray[np.float64], last: dict[int, float], pause: float
) -> NDArray[np.bool_]:
    """Return for each event whether it opens a series: no other of its pair in the `pause` s before it.

    Events are in order of time. `last` holds the time of each pair's last event in earlier chunks, and is
    brought up to date.
    """
    if len(pair) == 0:
        return np.zeros(0, dtype=np.bool_)
    order = np.lexsort((time, pair))
    sorted_pair, sorted_time = pair[order], time[order]
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = sorted_pair[1:] != sorted_pair[:-1]
    opens = np.ones(len(order), dtype=np.bool_)
    opens[1:] = first[1:] | (np.diff(sorted_time) > pause)
    ends = np.append(np.flatnonzero(first)[1:], len(order)) - 1
    for start, end in zip(np.flatnonzero(first).tolist(), ends.tolist(), strict=True):
        key = int(sorted_pair[start])
        opens[start] = bool(sorted_time[start] - last.get(key, -np.inf) > pause)
        last[key] = float(sorted_time[end])
    result = np.empty(len(order), dtype=np.bool_)
    result[order] = opens
    return result
