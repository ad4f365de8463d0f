"""The figures of clogs: when they were, and how long.

Where there is nothing to draw, the figure says so in words.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from robosim.analysis.clogs.clog import SHORTEST, TRANSITS, Clog
from robosim.analysis.figures.style import (
    CAUSES,
    COLUMN,
    FAINT,
    INK,
    LADEN,
    MOST_ROWS,
    PAGE,
    QUIET,
    UNLADEN,
    TimeUnit,
    make_log_log,
    one_axes,
    put_legend_above,
    say,
    time_unit,
)
from robosim.analysis.measure.metrics import NotDefined, clogged_share, clogs
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.measure.tails import survival
from robosim.analysis.report.words import number_of, percent


def clog_timeline(episodes: Sequence[Episode]) -> Figure:
    """Draw a row for each episode, with its clogs as bars in the colour of their cause."""
    shown = episodes[:MOST_ROWS]
    lanes = [_side_by_side(clogs(one)) for one in shown]
    figure, axes = one_axes(PAGE, 0.95 + 0.24 * max(len(shown), 3))
    if episodes[0].tunnels.count == 0:
        say(axes, "the arena has no tunnel: there is nothing to clog")
        return figure
    unit = time_unit(max(one.seconds for one in shown))
    for row, (one, placed) in enumerate(zip(shown, lanes, strict=True)):
        axes.axhline(row, color=FAINT, linewidth=0.5, zorder=0)
        _draw_standstills(axes, row, one, unit)
        for clog, lane, width in placed:
            _draw_clog(axes, row + (lane + 0.5) / width - 0.5, 0.72 / width, clog, one, unit)
        share = clogged_share(one)
        words = "" if isinstance(share, NotDefined) else percent(share)
        axes.text(1.01, row, words, transform=axes.get_yaxis_transform(), va="center")
    axes.text(1.01, -0.75, "clogged", transform=axes.get_yaxis_transform(), va="bottom", color=QUIET)
    axes.set_xlim(0.0, max(one.seconds for one in shown) / unit.seconds)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_yticks(range(len(shown)))
    axes.tick_params(axis="y", length=0)
    axes.set_ylabel(
        "episode" if len(shown) == len(episodes) else f"episode, first {MOST_ROWS} of {len(episodes)}"
    )
    axes.set_xlabel(f"time, {unit.name}")
    every = [clog for one in episodes for clog in clogs(one)]
    handles = [
        Patch(
            facecolor=fill.colour,
            hatch=fill.hatch,
            edgecolor=INK,
            linewidth=0.4,
            label=f"{cause.value} ({n})",
        )
        for cause, fill in CAUSES.items()
        if (n := sum(clog.cause is cause for clog in every))
    ]
    if any(clog.transits <= TRANSITS for one in shown for clog in one.standstills):
        handles.append(Patch(facecolor=FAINT, label="standstill too short for a clog"))
    if not every:
        handles.insert(0, Patch(facecolor="none", label=f"no clogs in {number_of(len(episodes), 'episode')}"))
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), columnspacing=1.2)
    return figure


def clog_durations(episodes: Sequence[Episode]) -> Figure:
    """Draw the share of standstills that last at least so long; beyond the line they are clogs."""
    figure, axes = one_axes(COLUMN, 2.5)
    first = episodes[0]
    axes.set_xlabel("duration of standstills d, s")
    axes.set_ylabel("share lasting d and more")
    stood = [clog for one in episodes for clog in one.standstills]
    if first.tunnels.count == 0 or not stood:
        why = "the arena has no tunnel" if first.tunnels.count == 0 else "no clogs, nor shorter standstills"
        say(axes, f"{why}: there are no durations")
        return figure
    period = first.arena.timing.decision_period
    seconds = np.array([(clog.end - clog.start) * period for clog in stood])
    ordered, share = survival(seconds)
    count = sum(clog.transits > TRANSITS for clog in stood)
    axes.plot(
        ordered,
        share,
        color=UNLADEN,
        linewidth=1.2,
        drawstyle="steps-pre",
        marker="o",
        markersize=2.5 if len(stood) <= 60 else 0.0,
        label=f"{len(stood)} standstills from {SHORTEST:g} transit times on",
    )
    for number, limit in enumerate(np.unique(np.round(TRANSITS * first.tunnels.transit_time, 1))):
        label = f"k = {TRANSITS:g} transit times: {count} last longer, the clogs" if number == 0 else None
        axes.axvline(limit, color=LADEN, linewidth=1.0, linestyle=(0, (5, 2)), label=label)
    transit = first.tunnels.transit_time
    left, right = SHORTEST * float(transit.min()), TRANSITS * float(transit.max())
    make_log_log(axes, (0.8 * left, 1.3 * max(float(ordered[-1]), right)), (0.7 / len(stood), 1.4))
    put_legend_above(figure, 1)
    return figure


def _side_by_side(found: Sequence[Clog]) -> list[tuple[Clog, int, int]]:
    """Return each clog with its lane, and how many lanes there are, so that clogs at once do not overlap."""
    ends: list[int] = []
    placed: list[tuple[Clog, int]] = []
    for clog in found:
        lane = next((lane for lane, end in enumerate(ends) if end <= clog.start), len(ends))
        ends[lane : lane + 1] = [clog.end]
        placed.append((clog, lane))
    return [(clog, lane, len(ends)) for clog, lane in placed]


def _draw_standstills(axes: Axes, row: float, episode: Episode, unit: TimeUnit) -> None:
    scale = episode.arena.timing.decision_period / unit.seconds
    short = [clog for clog in episode.standstills if clog.transits <= TRANSITS]
    spans = [(clog.start * scale, (clog.end - clog.start) * scale) for clog in short]
    axes.broken_barh(spans, (row - 0.15, 0.3), facecolor=FAINT, linewidth=0, zorder=1)


def _draw_clog(
    axes: Axes, middle: float, height: float, clog: Clog, episode: Episode, unit: TimeUnit
) -> None:
    scale = episode.arena.timing.decision_period / unit.seconds
    fill = CAUSES[clog.cause]
    axes.barh(
        middle,
        (clog.end - clog.start) * scale,
        left=clog.start * scale,
        height=height,
        facecolor=fill.colour,
        hatch=fill.hatch,
        edgecolor=INK,
        linewidth=0.4,
        zorder=2,
    )
