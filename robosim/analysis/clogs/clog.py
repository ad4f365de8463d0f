"""What a clog is: robots that want to move and cannot, linked by contact, while nobody gets through a tunnel.

The definition, in full:

- A robot is *held up* after a decision if within the last `HOLD` seconds at least half of its decisions were
  to move, and it has come less than half its length far.
- Held-up robots are *linked* if within that time they touched each other, or the same loose pellet at once.
  What a robot holds is a part of it.
- Linked robots are a *group* if one of them is in a tunnel or its mouth (within a robot's length of it), and
  they are at least two, or one that touched a loose pellet. Groups that share a robot are the same in
  time, also over a pause of that robot shorter than `HOLD`.
- A stay begins when its first robots came to a halt, `HOLD` before they were recognised. It is cut where a
  robot completes a passage of the tunnel that it began after that: came in at one end, left at the other.
  In a pause, such a passage ends the stay, and the next there begins no earlier. A piece that lasts longer
  than k free-flow transit times of the tunnel is a *clog*.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

TRANSITS = 2.0
"""Clogs last longer than this many free-flow transit times (k)."""
SHORTEST = 0.5
"""Pieces from this many transit times on are kept, so that k can be varied afterwards."""


class Cause(Enum):
    """Why nobody could move on as a clog began: the first that held at any time in its first `HOLD` s."""

    HEAD_ON = "head-on"
    """Two linked robots are bound in opposite directions and have yet to pass each other."""
    PELLET = "blocked by a pellet"
    """A member presses against a loose pellet."""
    TURNING = "turning"
    """A member stands across the tunnel."""
    QUEUE = "queue"
    """None of these: robots stand behind or beside each other, and the first does not move on."""


class Ending(Enum):
    """What ended a clog."""

    PASSAGE = "somebody got through"
    """A robot completed a passage that it had begun while the group stood, and the group still stood."""
    TOOK_PELLET = "pellet taken"
    """One that stood to the end took a pellet in the `HOLD` before it or after it."""
    BACKED_OFF = "one backed off"
    """Of those that stood to the end, the one that then moved most went away from its goal."""
    WENT_ON = "one went on"
    """Of those that stood to the end, the one that then moved most went toward its goal."""
    LET_GO = "no longer pressed"
    """Nobody moved away: the robots lost touch or no longer wanted to move."""
    RUN_ENDED = "run ended"
    """The clog outlasted the run, or the run ended in a pause of it."""


class Clog(NamedTuple):
    """One clog of one episode, or a standstill too short for one."""

    tunnel: int
    start: int
    """Decision after which its first members had come to a halt."""
    end: int
    """First decision after which it is over."""
    members: tuple[int, ...]
    """Every robot that was part of it, in order."""
    cause: Cause
    ending: Ending
    place: tuple[float, float]
    """Mean of the members' places as it was recognised, or at the passage that it began with, m."""
    distance: float
    """Mean of their distances to home, m."""
    transits: float
    """How long it lasted, in free-flow transit times of the tunnel."""


def clogs_among(found: Sequence[Clog], transits: float = TRANSITS) -> list[Clog]:
    """Return what of `found` lasted longer than `transits` free-flow transit times."""
    return [clog for clog in found if clog.transits > transits]


def clogged_decisions(clogs: Sequence[Clog], decisions: int) -> int:
    """Return after how many of the decisions 1 to `decisions` at least one of the clogs stood."""
    standing = np.zeros(decisions + 1, dtype=np.bool_)
    for clog in clogs:
        standing[max(clog.start, 1) : clog.end] = True
    return int(standing.sum())
