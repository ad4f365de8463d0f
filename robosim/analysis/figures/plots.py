"""The figures that are plain plots. Each takes the episodes of one evaluation and draws them together.

Where there is nothing to draw, the figure says so in words.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from robosim.analysis.figures.style import (
    ALPHA,
    COLUMN,
    FAINT,
    INK,
    LADEN,
    MODES,
    MOST_ROWS,
    QUIET,
    SERIES,
    UNLADEN,
    make_log_log,
    one_axes,
    put_legend_above,
    say,
    time_unit,
)
from robosim.analysis.measure.metrics import NotDefined, workload_gini
from robosim.analysis.measure.monitor import Episode, delivered_over_time
from robosim.analysis.measure.tails import LEAST, fit_power_law, survival
from robosim.analysis.measure.traffic import WINDOW, lapses
from robosim.analysis.measure.workload import lorenz_curve

Floats = NDArray[np.float64]

_LINES = 12
"""More episodes than these are a band, not lines of their own."""
_BINS = 8
"""Densities are averaged in so many bins."""
_LEAST_IN_BIN = 3


def pellets_over_time(episodes: Sequence[Episode]) -> Figure:
    """Draw the pellets that the team has delivered by each time: mean, and every episode or their range."""
    figure, axes = one_axes(COLUMN, 2.5)
    first = episodes[0]
    unit = time_unit(first.seconds)
    grid = np.unique(np.linspace(0, first.decisions, 601).round())
    time = grid * first.arena.timing.decision_period / unit.seconds
    counts = np.array([_delivered_at(episode, grid) for episode in episodes])
    if len(episodes) > _LINES:
        axes.fill_between(time, counts.min(0), counts.max(0), step="post", color=FAINT, linewidth=0)
        shown = "least to most"
    else:
        axes.plot(time, counts.T, color=UNLADEN, linewidth=0.6, alpha=0.6, drawstyle="steps-post")
        shown = "an episode"
    axes.plot(time, counts.mean(0), color=INK, linewidth=1.4)
    axes.set_xlim(0.0, max(float(time[-1]), 1e-9))
    axes.set_ylim(0.0, max(1.0, 1.05 * float(counts.max())))
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.set_xlabel(f"time, {unit.name}")
    axes.set_ylabel("pellets delivered by the team")
    per_decision = unit.seconds / first.arena.timing.decision_period
    to_decisions, to_time = (
        lambda values: np.multiply(values, per_decision),
        lambda values: np.divide(values, per_decision),
    )
    top = axes.secondary_xaxis("top", functions=(to_decisions, to_time))
    top.set_xlabel("decisions")
    top.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    if counts.max() == 0:
        axes.text(0.5, 0.5, "no pellet was delivered", transform=axes.transAxes, ha="center", color=QUIET)
    elif len(episodes) > 1:
        one: Line2D | Patch = Line2D([], [], color=UNLADEN, linewidth=0.6, alpha=0.6, label=shown)
        if len(episodes) > _LINES:
            one = Patch(color=FAINT, label=shown)
        mean = Line2D([], [], color=INK, linewidth=1.4, label=f"mean of {len(episodes)}")
        axes.legend(handles=[mean, one], loc="upper left")
    return figure


def lorenz(episodes: Sequence[Episode]) -> Figure:
    """Draw the Lorenz curves of the pellets that each robot delivered, and the diagonal of equal work."""
    figure, axes = one_axes(COLUMN, 3.0)
    curves = [curve for one in episodes if (curve := lorenz_curve(one.totals.delivered)) is not None]
    axes.set_xlabel("share of the robots, those with least work first")
    axes.set_ylabel("share of the pellets")
    if episodes[0].robots == 1:
        say(axes, "one robot has nobody to share its work with")
        return figure
    if not curves:
        say(axes, "no pellets were delivered: there is no work to share")
        return figure
    axes.plot([0, 1], [0, 1], color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)), label="equal work, Gini 0")
    for number, curve in enumerate(curves[:MOST_ROWS]):
        label = "an episode" if number == 0 and len(curves) > 1 else None
        axes.plot(curve[:, 0], curve[:, 1], color=UNLADEN, linewidth=0.6, alpha=0.6, label=label)
    mean = np.mean(curves, axis=0)
    defined = [value for one in episodes if not isinstance(value := workload_gini(one), NotDefined)]
    spread = f" ± {np.std(defined, ddof=1):.2f}" if len(defined) > 1 else ""
    axes.plot(
        mean[:, 0],
        mean[:, 1],
        color=INK,
        linewidth=1.4,
        marker="o",
        markersize=2.5,
        label=f"{'mean' if len(curves) > 1 else 'the episode'}, Gini {np.mean(defined):.2f}{spread}",
    )
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    axes.set_aspect("equal")
    axes.legend(loc="upper left")
    return figure


def fundamental_diagram(episodes: Sequence[Episode]) -> Figure:
    """Draw flow against density: a point for each tunnel in each 30 s, their mean, and free flow."""
    figure, axes = one_axes(COLUMN, 2.7)
    if draw_flow(axes, episodes):
        put_legend_above(figure, 2)
    return figure


def draw_flow(axes: Axes, episodes: Sequence[Episode]) -> bool:
    """Draw flow against density into `axes`; return whether there was any to draw."""
    axes.set_xlabel("density k, robots / m")
    axes.set_ylabel("flow q, robots / s")
    tunnels = episodes[0].tunnels.count
    tunnel = np.concatenate([one.traffic.windows.tunnel for one in episodes])
    density = np.concatenate([one.traffic.windows.density for one in episodes])
    flow = np.concatenate([one.traffic.windows.flow for one in episodes])
    if tunnels == 0 or not density.any():
        why = "the arena has no tunnel" if tunnels == 0 else "no robot was in a tunnel"
        if tunnels and len(density) == 0:
            why = f"the run is shorter than {WINDOW:.0f} s"
        say(axes, f"{why}: there is no flow to average")
        return False
    for number in range(tunnels):
        here = tunnel == number
        axes.plot(
            density[here],
            flow[here],
            linestyle="",
            marker="o^sDvP"[number % 6],
            markersize=3.0,
            markeredgewidth=0,
            alpha=0.45,
            color=SERIES[number % len(SERIES)],
            label=f"{WINDOW:.0f} s" + (f", tunnel {number}" if tunnels > 1 else ""),
        )
    speed = episodes[0].arena.robot.top_speed
    right = max(1.1 * float(density.max()), 1.0 / float(episodes[0].tunnels.length.min()))
    top = max(1.25 * float(flow.max()), 0.2 * speed * right)
    bottom = min(0.0, 1.15 * float(flow.min()))
    axes.plot(
        [0.0, top / speed],
        [0.0, top],
        color=QUIET,
        linewidth=0.8,
        linestyle=(0, (4, 3)),
        label=f"free flow, q = {speed:.2g} m/s · k",
    )
    _draw_binned(axes, density, flow)
    if bottom < 0.0:
        axes.axhline(0.0, color=FAINT, linewidth=0.6, zorder=0)
    axes.set_xlim(0.0, right)
    axes.set_ylim(bottom, top)
    return True


def lapse_survival(episodes: Sequence[Episode]) -> Figure:
    """Draw the share of the lapses between passages that last at least so long, and the power law's tail."""
    figure, axes = one_axes(COLUMN, 2.7)
    axes.set_xlabel("lapse between passages t, s")
    axes.set_ylabel("share of lapses of t and more")
    times = np.concatenate([lapses(one.traffic, one.arena.timing.decision_period) for one in episodes])
    if episodes[0].tunnels.count == 0 or len(times) == 0:
        why = "the arena has no tunnel" if episodes[0].tunnels.count == 0 else "fewer than two passages"
        say(axes, f"{why}: there are no lapses")
        return figure
    ordered, share = survival(times)
    axes.plot(
        ordered, share, color=UNLADEN, linewidth=1.2, drawstyle="steps-pre", label=f"{len(times)} lapses"
    )
    if len(times) == 1:
        axes.plot(ordered, share, color=UNLADEN, marker="o", markersize=3.0)
    fit = fit_power_law(times)
    if fit is None:
        axes.plot([], [], linestyle="", label=f"no tail: fewer than {LEAST}, or all alike")
    else:
        at = np.array([fit.t_min, ordered[-1]])
        tail = fit.values / len(times) * (at / fit.t_min) ** (1.0 - fit.alpha)
        label = f"{ALPHA} = {fit.alpha:.2f} ± {fit.error:.2f} from {fit.t_min:.3g} s on, n = {fit.values}"
        axes.plot(at, tail, color=LADEN, linewidth=1.2, linestyle=(0, (5, 2)), label=label)
    make_log_log(axes, (0.8 * float(ordered[0]), 1.25 * float(ordered[-1])), (0.7 / len(times), 1.4))
    put_legend_above(figure, 1)
    return figure


def trip_times(episodes: Sequence[Episode]) -> Figure:
    """Draw the mean time of a trip as a bar of its modes, for the team and for each robot."""
    robots = episodes[0].robots
    names = ["team", *map(str, range(robots))] if 1 < robots <= MOST_ROWS else ["team"]
    figure, axes = one_axes(COLUMN, 1.35 + 0.19 * max(len(names), 3))
    trips = [trip for one in episodes for trip in one.trips]
    if not trips:
        say(axes, "no trips: nobody delivered a pellet")
        return figure
    robot = np.array([trip.robot for trip in trips])
    seconds = np.array([trip.seconds for trip in trips])
    rows = [seconds, *(seconds[robot == one] for one in range(len(names) - 1))]
    for row, times in enumerate(rows):
        left = 0.0
        for mode, (_, colour) in MODES.items():
            width = float(times[:, mode].mean()) if len(times) else 0.0
            axes.barh(row, width, left=left, height=0.74, color=colour, linewidth=0)
            left += width
        if len(times) == 0:
            axes.text(0.0, row, " no trips", va="center", color=QUIET)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("mean time of a trip, s")
    if len(names) > 1:
        axes.set_ylabel("robot")
    handles = [Patch(facecolor=colour, label=name) for name, colour in MODES.values()]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, columnspacing=1.2)
    return figure


def _delivered_at(episode: Episode, grid: Floats) -> Floats:
    steps, counts = delivered_over_time(episode)
    team = counts.sum(axis=1).astype(np.float64)
    return np.asarray(team[np.searchsorted(steps, grid, side="right") - 1])


def _draw_binned(axes: Axes, density: Floats, flow: Floats) -> None:
    """Draw the mean flow at each density, with its standard error, where there are points enough."""
    edges = np.linspace(density.min(), density.max(), _BINS + 1)
    number = np.clip(np.searchsorted(edges, density, side="right") - 1, 0, _BINS - 1)
    bins = [number == one for one in range(_BINS) if (number == one).sum() >= _LEAST_IN_BIN]
    if not bins:
        return
    axes.errorbar(
        [density[one].mean() for one in bins],
        [flow[one].mean() for one in bins],
        yerr=[flow[one].std(ddof=1) / np.sqrt(one.sum()) for one in bins],
        color=INK,
        linewidth=1.2,
        elinewidth=0.8,
        marker="o",
        markersize=3.5,
        label="mean ± error",
    )
