"""Space-time diagrams: where along the tunnel every robot is, over time, and where it clogs."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator, MultipleLocator
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from robosim.analysis.clogs.clog import Clog
from robosim.analysis.clogs.groups import HOLD
from robosim.analysis.figures.spans import Span, around, longest_clog, strips
from robosim.analysis.figures.style import INK, LADEN, PAGE, QUIET, UNLADEN, TimeUnit, say, time_unit
from robosim.analysis.measure.metrics import clogs
from robosim.analysis.measure.monitor import Episode
from robosim.analysis.report.words import number_of

Floats = NDArray[np.float64]

_TICKS = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0)
"""Time between ticks when seen from near, s."""
_NUMBER_HEIGHT = 0.065
"""Room that a robot's number takes at the border, in heights of a panel."""
_CLOG, _CLOG_HATCH, _TUNNEL = "#e8e4c9", "#8c8560", "#f3f5f7"
_DASHES = (0, (4, 3))


def space_time(episodes: Sequence[Episode]) -> Figure:
    """Draw the episode with the longest clog, or the first, in strips one below the other."""
    number, clog = longest_clog(episodes)
    episode = episodes[number]
    spans = strips(episode, clog)
    whole = spans[0].begin == 0.0 and spans[-1].end >= episode.seconds
    title = f"episode {number}" if whole else f"episode {number}, a part of it"
    return _draw(episode, spans, range(episode.tunnels.count), title, near=False)


def space_time_of_clog(episodes: Sequence[Episode]) -> Figure:
    """Draw the longest clog of all episodes from near: how it began, and how it ended."""
    number, clog = longest_clog(episodes)
    episode = episodes[number]
    if clog is None:
        why = (
            "the arena has no tunnel"
            if episode.tunnels.count == 0
            else f"no clogs in {number_of(len(episodes), 'episode')}"
        )
        return _nothing(f"{why}: there is none to look at from near")
    seconds = (clog.end - clog.start) * episode.arena.timing.decision_period
    title = f"episode {number}: {clog.cause.value}, {seconds:.0f} s, {clog.ending.value}"
    return _draw(episode, around(clog, episode), [clog.tunnel], title, near=True)


def _nothing(sentence: str) -> Figure:
    figure = Figure(figsize=(PAGE, 1.6))
    say(figure.add_subplot(), sentence)
    return figure


def _draw(
    episode: Episode, spans: Sequence[Span], tunnels: Sequence[int], title: str, *, near: bool
) -> Figure:
    """Draw a panel for each tunnel in each span, below each other; from `near`, larger and with numbers."""
    if len(tunnels) == 0 or len(episode.traffic.track_step) < 2:
        why = "the arena has no tunnel" if len(tunnels) == 0 else "the run is too short for a line"
        return _nothing(f"{why}: there is no space-time diagram")
    rows = len(spans) * len(tunnels)
    height = 2.6 if near else max(0.75, min(1.5, 7.5 / rows))
    figure = Figure(figsize=(PAGE, 0.9 + rows * height))
    panels = figure.subplots(rows, 1, squeeze=False)[:, 0]
    unit = time_unit(episode.seconds)
    for panel, (span, tunnel) in zip(panels, itertools.product(spans, tunnels), strict=True):
        draw_panel(panel, episode, tunnel, span, unit, near=near)
        if len(tunnels) > 1:
            panel.set_ylabel(f"tunnel {tunnel}")
            panel.tick_params(axis="x", labelbottom=tunnel == tunnels[-1])
    panels[0].set_title(title, loc="left")
    panels[-1].set_xlabel("time, min:s" if near else f"time, {unit.name}")
    figure.supylabel("distance from home, m", fontsize=8.0)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=UNLADEN, linewidth=1.2, label="unladen"),
        Line2D([], [], color=LADEN, linewidth=1.2, label="laden"),
        Patch(facecolor=_TUNNEL, edgecolor=QUIET, linewidth=0.6, linestyle=_DASHES, label="tunnel"),
    ]
    if clogs(episode):
        handles.append(Patch(facecolor=_CLOG, hatch="////", edgecolor=INK, linewidth=0.6, label="clog"))
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), columnspacing=1.2)
    return figure


def draw_panel(axes: Axes, episode: Episode, tunnel: int, span: Span, unit: TimeUnit, *, near: bool) -> None:
    """Draw the path of every robot along one tunnel, and its clogs, within `span`; numbered from `near`."""
    period = episode.arena.timing.decision_period
    begin, length = float(episode.tunnels.home_end[tunnel]), float(episode.tunnels.length[tunnel])
    axes.axhspan(begin, begin + length, facecolor=_TUNNEL, linewidth=0, zorder=0)
    for end in (begin, begin + length):
        axes.axhline(end, color=QUIET, linewidth=0.6, linestyle=_DASHES, zorder=1)
    for clog in clogs(episode):
        if clog.tunnel == tunnel and clog.start * period < span.end and clog.end * period > span.begin:
            _draw_extent(axes, episode, clog, span, unit)
    pieces = [piece for robot in range(episode.robots) for piece in _pieces(episode, robot, tunnel, span)]
    lines = LineCollection(
        [piece.points / (unit.seconds, 1.0) for piece in pieces],
        colors=[LADEN if piece.laden else UNLADEN for piece in pieces],
        linewidths=1.0 if near else 0.6,
        zorder=3,
    )
    axes.add_collection(lines, autolim=False)
    axes.set_xlim(span.begin / unit.seconds, span.end / unit.seconds)
    axes.set_ylim(*_limits(episode, tunnel))
    axes.yaxis.set_major_locator(
        MaxNLocator(6, steps=[1, 2, 5, 10]) if near else MultipleLocator(_tick(length))
    )
    axes.xaxis.set_major_locator(MaxNLocator(6))
    if near:
        every = next((tick for tick in _TICKS if span.end - span.begin < 10.0 * tick), _TICKS[-1])
        axes.xaxis.set_major_locator(MultipleLocator(every / unit.seconds))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda time, _: _clock(time * unit.seconds)))
        _draw_numbers(axes, episode, tunnel, span)


def _clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{round(seconds) // 60}:{round(seconds) % 60:02}"


def _tick(length: float) -> float:
    """Return a round distance between ticks: a power of ten up to a length."""
    return float(10.0 ** np.floor(np.log10(max(length, 1e-3))))


def _limits(episode: Episode, tunnel: int) -> tuple[float, float]:
    """Return the stretch to show: the tunnel and what lies before its ends, m."""
    begin, length = float(episode.tunnels.home_end[tunnel]), float(episode.tunnels.length[tunnel])
    far = float(episode.traffic.track.max())
    beside = 0.5 * length if episode.tunnels.count == 1 else 1.5 * episode.arena.robot.length
    return max(-0.02 * length, begin - beside), max(
        begin + length, min(far + 0.02 * length, begin + length + beside)
    )


class _Piece(NamedTuple):
    """A part of a robot's line in one colour."""

    laden: bool
    points: Floats
    """[n, 2] time, s, and distance from home, m."""


def _pieces(episode: Episode, robot: int, tunnel: int, span: Span) -> list[_Piece]:
    """Cut a robot's line where it takes or drops a pellet, and where it is at another tunnel or at none.

    Where there is only one tunnel, the line goes on outside it.
    """
    traffic = episode.traffic
    seconds = traffic.track_step * episode.arena.timing.decision_period
    # One point more on either side, so that lines go on to the border.
    first = max(0, int(np.searchsorted(seconds, span.begin)) - 1)
    rows = slice(first, int(np.searchsorted(seconds, span.end, side="right")) + 1)
    at, laden = traffic.track_tunnel[rows, robot], traffic.track_laden[rows, robot]
    points = np.stack([seconds[rows], traffic.track[rows, robot]], axis=-1)
    if episode.tunnels.count == 1:
        shown = np.ones(max(0, len(at) - 1), dtype=np.bool_)
    else:
        # With the line from the last point before the tunnel, and to the first behind it.
        shown = ((at[:-1] == tunnel) & (at[1:] < 0)) | (at[1:] == tunnel) & (at[:-1] < 0)
        shown |= (at[:-1] == tunnel) & (at[1:] == tunnel)
    kind = np.where(shown, laden[1:].astype(np.int8), -1)
    cuts = (np.flatnonzero(np.diff(kind)) + 1).tolist()
    return [
        _Piece(bool(kind[begin]), points[begin : end + 1])
        for begin, end in zip([0, *cuts], [*cuts, len(kind)], strict=True)
        if end > begin and kind[begin] >= 0
    ]


def _draw_numbers(axes: Axes, episode: Episode, tunnel: int, span: Span) -> None:
    """Write at the right border which line is whose, if there is room for all numbers."""
    traffic = episode.traffic
    seconds = traffic.track_step * episode.arena.timing.decision_period
    row = max(0, int(np.searchsorted(seconds, span.end, side="right")) - 1)
    place = np.array(
        [np.interp(span.end, seconds, traffic.track[:, robot]) for robot in range(episode.robots)]
    )
    low, high = axes.get_ylim()
    drawn = (place >= low) & (place <= high)
    if episode.tunnels.count > 1:
        drawn &= traffic.track_tunnel[row] == tunnel
    there = [robot for robot in np.argsort(place, kind="stable").tolist() if drawn[robot]]
    if len(there) * _NUMBER_HEIGHT > 1.0:
        return
    apart = (high - low) * _NUMBER_HEIGHT
    at = spread_apart(place[there], apart)
    for robot, y in zip(there, at, strict=True):
        colour = LADEN if traffic.track_laden[row, robot] else UNLADEN
        axes.annotate(
            str(robot),
            (1.0, place[robot]),
            xytext=(1.025, y),
            xycoords=axes.get_yaxis_transform(),
            textcoords=axes.get_yaxis_transform(),
            va="center",
            color=colour,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1.0, "shrinkB": 0.0},
            annotation_clip=False,
        )


def spread_apart(place: Floats, apart: float) -> Floats:
    """Move sorted places at least `apart`, all together as little as it takes (least squares)."""
    # Places less their order may come no closer than equal: isotonic regression.
    order = apart * np.arange(len(place))
    return np.asarray(isotonic_regression(place - order).x + order)


def _draw_extent(axes: Axes, episode: Episode, clog: Clog, span: Span, unit: TimeUnit) -> None:
    """Hatch where the members of a clog stand while it lasts, within `span`."""
    time, low, high = _extent(episode, clog, span)
    axes.fill_between(
        time / unit.seconds,
        low,
        high,
        facecolor=_CLOG,
        hatch="////",
        edgecolor=_CLOG_HATCH,
        linewidth=0.0,
        zorder=0.5,
    )
    axes.plot(
        np.concatenate([time, time[::-1], time[:1]]) / unit.seconds,
        np.concatenate([low, high[::-1], low[:1]]),
        color=INK,
        linewidth=0.7,
        zorder=2,
    )


def _extent(episode: Episode, clog: Clog, span: Span) -> tuple[Floats, Floats, Floats]:
    """Return times [n] in s, and between which distances from home the clog's members stand then, m."""
    traffic, period = episode.traffic, episode.arena.timing.decision_period
    half, step = 0.5 * episode.arena.robot.length, traffic.track_step
    every = int(step[1] - step[0])
    # A point more than the span has on either side, so that its border does not look like the clog's end.
    first = max(clog.start, int(span.begin / period) - 2 * every)
    last = min(clog.end, int(span.end / period) + 2 * every)
    rows = np.flatnonzero((step >= first) & (step < last))
    members, apart = list(clog.members), max(1, round(0.5 * HOLD / (every * period)))
    place = traffic.track[:, members].astype(np.float64)
    displacement = np.abs(place[np.minimum(rows + apart, len(step) - 1)] - place[np.maximum(rows - apart, 0)])
    stands = (displacement < half) & (traffic.track_tunnel[rows][:, members] == clog.tunnel)
    seen = stands.any(axis=1)
    low = np.where(stands, place[rows], np.inf).min(axis=1, initial=np.inf)[seen]
    high = np.where(stands, place[rows], -np.inf).max(axis=1, initial=-np.inf)[seen]
    if not seen.any():
        # It lies between two points.
        low = high = np.array([clog.distance])
    time = np.array([first, *step[rows[seen]], last]) * period
    at = np.array([0, *range(seen.sum()), max(0, int(seen.sum()) - 1)])
    return time, low[at] - half, high[at] + half
