"""What was measured, in words: for the report's page and the command line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from robosim.analysis.clogs.clog import TRANSITS
from robosim.analysis.measure.metrics import MetricValue, NotDefined, clogged_share, clogs, stop_share
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.measure.strategy import Strategy, classify
from robosim.analysis.report.tables import counted

_OFTEN = 0.05
"""Share of decisions from which on it is worth a sentence."""


def congestion_lines(episodes: Sequence[Episode]) -> list[tuple[str, str]]:
    """Return the main numbers of congestion, each with its name, for the command line."""
    lines = [("time clogged", clogged_in_short(episodes))]
    found = [clog for one in episodes for clog in clogs(one)]
    if found:
        lines.append(("causes of clogs", listed(counted(clog.cause for clog in found))))
        lines.append(("clogs ended by", listed(counted(clog.ending for clog in found))))
    lines.append(("strategy", strategies_in_short(episodes)))
    return lines


def clogged_in_short(episodes: Sequence[Episode]) -> str:
    """Return the share of time clogged, how many clogs there were, and the longest."""
    if episodes[0].tunnels.count == 0:
        return "not defined: the arena has no tunnel"
    seconds = [
        one.arena.timing.decision_period * (clog.end - clog.start) for one in episodes for clog in clogs(one)
    ]
    share = mean_share([clogged_share(one) for one in episodes])
    if not seconds:
        return f"{share}, no clogs"
    return f"{share}, {number_of(len(seconds), 'clog')}, the longest {max(seconds):.0f} s"


def strategies_in_short(episodes: Sequence[Episode]) -> str:
    """Return which strategies were seen, and in how many of the episodes."""
    seen = Counter(classify(one).strategy for one in episodes).most_common()
    return ", ".join(
        f"{_named(one)} in {count} of {number_of(len(episodes), 'episode')}" for one, count in seen
    )


def summary_sentences(episodes: Sequence[Episode]) -> list[str]:
    """Return what happened in a few sentences."""
    first = episodes[0]
    totals = [int(one.totals.delivered.sum()) for one in episodes]
    team = "One robot" if first.robots == 1 else f"A team of {first.robots} robots"
    if len(totals) == 1:
        pellets = number_of(totals[0], "pellet")
    elif min(totals) == max(totals):
        pellets = f"{number_of(totals[0], 'pellet')} each time"
    else:
        pellets = f"{sum(totals) / len(totals):.1f} pellets on average ({min(totals)} to {max(totals)})"
    length = f"{number_of(first.decisions, 'decision')} ({minutes(first.seconds)})"
    why = classify(first).reason
    sentences = [
        f"{team} delivered {pellets} in {length}.",
        f"Strategy: {strategies_in_short(episodes)}"
        + (f" ({why})." if len(totals) == 1 else f"; episode 0: {why}."),
        *_clog_sentences(episodes),
    ]
    stops = stop_share(first)
    if not isinstance(stops, NotDefined) and stops >= _OFTEN:
        sentences.append(
            f"In episode 0, {percent(stops)} of all decisions were to stop: "
            "who stands by choice is in no clog."
        )
    return sentences


def clog_definition(episode: Episode) -> str:
    """Return what counts as a clog in this arena."""
    words = (
        "Robots that decide to move and cannot, linked by contact with each other or with the same loose "
        "pellet, at least one of them in a tunnel or its mouth, while nobody gets through the tunnel"
    )
    times = sorted({round(TRANSITS * float(time), 1) for time in episode.tunnels.transit_time})
    if not times:
        return f"{words}. This arena has no tunnel, and so no clogs."
    seconds = " or ".join(f"{time:g} s" for time in times)
    return (
        f"{words}, for longer than k = {TRANSITS:g} times what a robot at top speed takes for the tunnel: "
        f"here {seconds}. Robots that decide to stop are in no clog."
    )


def mean_share(shares: Sequence[MetricValue]) -> str:
    """Return the mean of shares as a percentage."""
    defined = [share for share in shares if not isinstance(share, NotDefined)]
    return percent(sum(defined) / len(defined)) if defined else "not defined"


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{100.0 * share:.1f} %"


def listed(counts: Mapping[str, int]) -> str:
    """Return counts as words: head-on 4, queue 1."""
    return ", ".join(f"{name} {count}" for name, count in counts.items())


def number_of(count: int, what: str) -> str:
    """Return a count and what is counted."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def minutes(seconds: float) -> str:
    """Return a time as text."""
    return f"{seconds:.3g} s" if seconds < 120.0 else f"{seconds / 60.0:.3g} min"


def _named(strategy: Strategy) -> str:
    if strategy is not Strategy.NEITHER:
        return str(strategy.value)
    return f"neither {Strategy.ONE_AT_A_TIME.value} nor {Strategy.BUCKET_BRIGADE.value}"


def _clog_sentences(episodes: Sequence[Episode]) -> list[str]:
    found = [(number, clog) for number, one in enumerate(episodes) for clog in clogs(one)]
    if episodes[0].tunnels.count == 0:
        return ["The arena has no tunnel, so nothing could clog."]
    if not found:
        short = sum(len(one.standstills) for one in episodes)
        return [
            f"There was no clog, only {number_of(short, 'shorter standstill')}."
            if short
            else "There was no clog."
        ]
    struck = len({number for number, _ in found})
    share = mean_share([clogged_share(one) for one in episodes])
    number, longest = max(found, key=lambda pair: pair[1].end - pair[1].start)
    seconds = episodes[0].arena.timing.decision_period * (longest.end - longest.start)
    robots = number_of(len(longest.members), "robot")
    causes = counted(clog.cause for _, clog in found)
    cause, often = next(iter(causes.items()))
    were = "was 1 clog" if len(found) == 1 else f"were {len(found)} clogs"
    return [
        f"There {were}, in {struck} of {number_of(len(episodes), 'episode')}.",
        f"{share} of the time {'it' if len(found) == 1 else 'at least one'} stood.",
        f"The longest lasted {seconds:.0f} s, in episode {number}, and held {robots}.",
        f"The most frequent cause was: {cause} ({often} of {len(found)}).",
        f"What ended them: {listed(counted(clog.ending for _, clog in found))}.",
    ]
