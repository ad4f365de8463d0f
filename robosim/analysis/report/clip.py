"""The report's moving picture: the longest clog, from a little before it until a little after it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import islice
from typing import NamedTuple

from robosim.analysis.film import Pace, film_bytes
from robosim.analysis.measure.metrics import clogs
from robosim.analysis.measure.monitor import Episode
from robosim.episodes.replay import replay
from robosim.episodes.trajectory import Trajectory

AROUND = 5.0
"""Time before and after the clog, s."""
MOST_PICTURES = 60
"""So that the page stays small, however long the clog lasted."""
_PICTURE_SECONDS = Fraction(1, 8)
_LONG_SIDE = 640
_QUALITY = 50


class Clip(NamedTuple):
    """A moving picture and what it shows."""

    image: bytes
    """Animated WebP."""
    caption: str


def longest_clog(episodes: Sequence[Episode], trajectories: Sequence[Trajectory]) -> Clip | None:
    """Return the longest clog of all episodes as a moving picture, None if there was none.

    Its episode is run again up to there.
    """
    found = [(number, clog) for number, one in enumerate(episodes) for clog in clogs(one)]
    if not found:
        return None
    number, clog = max(found, key=lambda pair: pair[1].end - pair[1].start)
    arena, decisions = episodes[number].arena, len(trajectories[number].chosen)
    period = arena.timing.decision_period
    more = round(AROUND / period)
    start, end = max(0, clog.start - more), min(decisions, clog.end + more)
    every = math.ceil((end - start + 1) / MOST_PICTURES)
    image = film_bytes(
        islice(replay(trajectories[number]), start, end + 1),
        arena,
        Pace(every, _PICTURE_SECONDS),
        long_side=_LONG_SIDE,
        quality=_QUALITY,
    )
    members = ", ".join(map(str, clog.members))
    caption = (
        f"The longest clog: {clog.cause.value}, robots {members}, in episode {number}. Shown are "
        f"{(end - start) * period:.0f} s from decision {start} on, {every * period / _PICTURE_SECONDS:.3g} "
        "times as fast as they happened. Red: robots in touch with something that want to move and cannot."
    )
    return Clip(image, caption)
