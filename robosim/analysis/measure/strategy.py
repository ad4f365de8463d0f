"""Which strategy of sharing a tunnel an episode shows: One-at-a-Time, Bucket-Brigade, or neither."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from robosim.analysis.measure.metrics import NotDefined, alone_share, bidirectional_share, lane_segregation
from robosim.analysis.measure.monitor import Episode

MOSTLY = 0.8
"""Share of the time in use from which on a tunnel is used by one robot at a time."""
LANES = 0.6
"""Segregation from which on laden and unladen robots have lanes of their own."""
BIDIRECTIONAL = 0.2
"""Share of the time in use from which on traffic in both directions is a strategy."""
PASSAGES = 10
"""Fewer passages than these show no strategy."""


class Strategy(Enum):
    """The names are the paper's."""

    ONE_AT_A_TIME = "One-at-a-Time"
    BUCKET_BRIGADE = "Bucket-Brigade"
    NEITHER = "neither"


class Classified(NamedTuple):
    """A strategy, and the numbers that show it."""

    strategy: Strategy
    reason: str


def classify(episode: Episode) -> Classified:
    """Return the strategy of an episode.

    One-at-a-Time: one robot alone in the tunnels for at least 80 % of the time in which there is any.
    Bucket-Brigade: laden and unladen robots move along the tunnels at once for at least 20 % of that time,
    in lanes of their own (segregation of at least 0.6). Neither: all else, and any team of one robot or with
    fewer than ten passages.
    """
    if episode.robots == 1:
        return Classified(Strategy.NEITHER, "one robot")
    through = sum(visit.passage for visit in episode.traffic.visits)
    if through < PASSAGES:
        return Classified(Strategy.NEITHER, f"{through} passages, fewer than {PASSAGES}")
    alone, both, lanes = (share(episode) for share in (alone_share, bidirectional_share, lane_segregation))
    if isinstance(alone, NotDefined) or isinstance(both, NotDefined):
        return Classified(Strategy.NEITHER, "no robot was in a tunnel")
    apart = 0.0 if isinstance(lanes, NotDefined) else lanes
    reason = (
        f"alone {100 * alone:.0f} % of the time in use, both directions at once {100 * both:.0f} %, "
        f"segregation {apart:.2f}"
    )
    if alone >= MOSTLY:
        return Classified(Strategy.ONE_AT_A_TIME, reason)
    if both >= BIDIRECTIONAL and apart >= LANES:
        return Classified(Strategy.BUCKET_BRIGADE, reason)
    return Classified(Strategy.NEITHER, reason)
