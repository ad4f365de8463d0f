"""Figures that compare systems: a colour for each system, the same in all panels and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator
from numpy.typing import NDArray

from robosim.analysis.figures.style import COLUMN, FAINT, INK, PAGE, QUIET, SERIES, put_legend_above
from robosim.equality import EqualByValue

Floats = NDArray[np.float64]

_MARKERS = "os^Dvp*X"
_DASHES = ((0, ()), (0, (4, 2)), (0, (1, 1.5)), (0, (5, 1.5, 1, 1.5)))
_PANEL_HEIGHT = 1.75
_LEGEND_ROW = 0.17
"""Height of a row of a legend, inches."""
_FEW = 10.0
"""Touches up to which an axis is linear, so that it has a place for none; logarithmic above."""


@dataclass(frozen=True, slots=True, eq=False)
class Line(EqualByValue):
    """A system in a panel: all arrays are [points]."""

    name: str
    x: Floats
    y: Floats
    low: Floats | None = None
    """Bounds of the intervals; None where there are none."""
    high: Floats | None = None


@dataclass(frozen=True, slots=True)
class Systems:
    """All systems that are compared: each looks the same wherever it is drawn."""

    names: Sequence[str]
    reference: str | None = None
    """The one that the others are measured by, drawn in black; None where it differs from task to task."""

    def colour(self, name: str) -> str:
        return INK if name == self.reference else SERIES[self._number(name) % len(SERIES)]

    def dash(self, name: str) -> tuple[float, tuple[float, ...]]:
        """Return how its lines are dashed: dashed ones have the colours in the same order again."""
        return _DASHES[self._number(name) // len(SERIES) % len(_DASHES)]

    def marker(self, name: str) -> str:
        return _MARKERS[self._number(name) % len(_MARKERS)]

    def _number(self, name: str) -> int:
        others = [one for one in self.names if one != self.reference]
        return others.index(name) if name in others else 0


@dataclass(frozen=True, slots=True)
class Panel:
    """The systems in one task."""

    title: str
    lines: Sequence[Line]


def learning_curves(panels: Sequence[Panel], systems: Systems) -> Figure:
    """Draw pellets against joint decisions, a panel for each task."""

    def finish(axes: Axes) -> None:
        axes.set_ylim(bottom=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_major_formatter(lambda value, _: _thousands(value))

    return _panels(
        panels, systems, "joint decisions", "pellets in 1000 decisions,\nexploration included", finish
    )


def cumulative_pellets(panels: Sequence[Panel], systems: Systems) -> Figure:
    """Draw the pellets delivered by each decision of an episode, a panel for each task."""

    def finish(axes: Axes) -> None:
        axes.set_ylim(bottom=0.0)
        axes.set_xlim(left=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_major_formatter(lambda value, _: _thousands(value))

    return _panels(panels, systems, "decisions", "pellets delivered by the team", finish)


def lorenz_curves(panels: Sequence[Panel], systems: Systems) -> Figure:
    """Draw the Lorenz curves of the pellets that robots delivered, a panel for each task."""

    def finish(axes: Axes) -> None:
        axes.plot([0, 1], [0, 1], color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), aspect="equal")
        axes.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"])
        axes.set_yticks([0.0, 0.5, 1.0], ["0", "0.5", "1"])

    return _panels(
        panels, systems, "share of the robots, those with least work first", "share of the pellets", finish
    )


def performance_profiles(lines: Sequence[Line], systems: Systems, of: str) -> Figure:
    """Draw the share of runs above each normalised score; `of` is what a score of 1 means."""

    def finish(axes: Axes) -> None:
        axes.set_ylim(0.0, 1.02)
        axes.axvline(1.0, color=FAINT, linewidth=0.8, zorder=0)
        axes.margins(x=0.0)

    x = f"normalised score \N{GREEK SMALL LETTER TAU}, 1 is {of}"
    return _panels([Panel("", lines)], systems, x, "share of runs above \N{GREEK SMALL LETTER TAU}", finish)


def by_team_size(panels: Sequence[Panel], systems: Systems, metric: str) -> Figure:
    """Draw interquartile means with their intervals against the number of robots, a panel for each arena."""
    figure, grid = _grid(len(panels), columns=2, height=2.4, legend=systems)
    labelled: set[str] = set()
    for axes, panel in zip(grid, panels, strict=True):
        sizes = sorted({float(size) for line in panel.lines for size in line.x})
        for line in panel.lines:
            # Beside each other, so that intervals do not cover one another.
            place = (systems.names.index(line.name) + 0.5) / len(systems.names) - 0.5
            x = line.x + place * min(0.36 * _least_gap(sizes), 0.04 * (sizes[-1] - sizes[0]) or 0.04)
            bars = None if line.low is None or line.high is None else [line.y - line.low, line.high - line.y]
            axes.errorbar(
                x,
                line.y,
                yerr=None if bars is None else np.clip(bars, 0.0, None),
                color=systems.colour(line.name),
                linestyle=systems.dash(line.name),
                linewidth=0.9,
                elinewidth=1.1,
                capsize=1.8,
                marker=systems.marker(line.name),
                markersize=3.5,
                clip_on=False,
                label=_once(line.name, labelled),
            )
        axes.set_title(panel.title)
        axes.xaxis.set_major_locator(FixedLocator(sizes))
        if len(sizes) == 1:
            # Or the axis would be scaled to what keeps the points apart.
            axes.set_xlim(sizes[0] - 0.5, sizes[0] + 0.5)
        axes.set_xlabel("robots")
        axes.set_ylim(bottom=0.0)
    grid[0].set_ylabel(f"{metric} per episode, IQM")
    put_legend_above(figure, _legend_columns(systems.names, figure.get_figwidth()))
    return figure


def pellets_against_touches(panels: Sequence[Panel], systems: Systems) -> Figure:
    """Draw a point for each run, its touches and its pellets in an episode, a panel for each task."""

    def finish(axes: Axes) -> None:
        axes.set_xscale("symlog", linthresh=_FEW)
        axes.set_xlim(_decades(axes.dataLim.x0, axes.dataLim.x1))
        axes.xaxis.set_major_formatter(lambda value, _: _thousands(value))
        axes.set_ylim(bottom=0.0)

    return _panels(
        panels, systems, "touches per episode, summed over robots", "pellets per episode", finish, _points
    )


def improvement(panels: Sequence[Panel], systems: Systems, baseline: str) -> Figure:
    """Draw the probability of improvement over the baseline with its interval, a panel for each task.

    Of a line only the first point counts: `x` is the probability, and the interval is along it.
    """
    rows = max(len(panel.lines) for panel in panels)
    figure, grid = _grid(len(panels), columns=3, height=0.75 + 0.2 * rows)
    for axes, panel in zip(grid, panels, strict=True):
        for row, line in enumerate(panel.lines):
            colour, value = systems.colour(line.name), float(line.x[0])
            if line.low is not None and line.high is not None:
                ends = [float(line.low[0]), float(line.high[0])]
                axes.plot(ends, [row, row], color=colour, linewidth=3.0, alpha=0.5, solid_capstyle="butt")
            axes.plot(value, row, marker="o", markersize=4.5, color=colour, clip_on=False)
        axes.axvline(0.5, color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
        axes.set_yticks(range(len(panel.lines)), [line.name for line in panel.lines])
        axes.set_ylim(len(panel.lines) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.0)
        axes.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"])
        axes.set_title(panel.title)
    figure.supxlabel(f"probability that a run does better than one of {baseline}", fontsize=8.0)
    return figure


def _curve(axes: Axes, line: Line, systems: Systems, label: str | None) -> None:
    colour = systems.colour(line.name)
    if line.low is not None and line.high is not None:
        axes.fill_between(line.x, line.low, line.high, color=colour, alpha=0.2, linewidth=0)
    axes.plot(line.x, line.y, color=colour, linestyle=systems.dash(line.name), linewidth=1.2, label=label)


def _points(axes: Axes, line: Line, systems: Systems, label: str | None) -> None:
    axes.plot(
        line.x,
        line.y,
        color=systems.colour(line.name),
        linestyle="",
        marker=systems.marker(line.name),
        markersize=4.0,
        markeredgewidth=0.0,
        alpha=0.8,
        clip_on=False,
        label=label,
    )


def _panels(
    panels: Sequence[Panel],
    systems: Systems,
    x: str,
    y: str,
    finish: Callable[[Axes], None],
    draw: Callable[[Axes, Line, Systems, str | None], None] = _curve,
) -> Figure:
    """Draw panels that share what their axes show, and one legend for all; lines with bands by default."""
    columns = 4 if len(panels) > 3 else len(panels)
    height = 2.2 if len(panels) == 1 else _PANEL_HEIGHT
    figure, grid = _grid(len(panels), columns, height, systems)
    labelled: set[str] = set()
    for axes, panel in zip(grid, panels, strict=True):
        for line in panel.lines:
            draw(axes, line, systems, _once(line.name, labelled))
        axes.set_title(panel.title)
        finish(axes)
    if len(panels) == 1:
        grid[0].set_xlabel(x)
    else:
        figure.supxlabel(x, fontsize=8.0)
    for first in grid[::columns]:
        first.set_ylabel(y)  # beside the axes: in the middle of the figure it would run into the legend
    put_legend_above(figure, _legend_columns(systems.names, figure.get_figwidth()))
    return figure


def _grid(
    count: int, columns: int, height: float, legend: Systems | None = None
) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` axes, a column wide for one and a page wide for more.

    It is so high that the axes keep their `height` below the legend of those systems.
    """
    rows = ceil(count / columns)
    width = COLUMN if count == 1 else PAGE
    above = 0.0
    if legend is not None:
        above = _LEGEND_ROW * (ceil(len(legend.names) / _legend_columns(legend.names, width)) - 1)
    figure = Figure(figsize=(width, 0.5 + above + rows * height))
    return figure, [figure.add_subplot(rows, min(columns, count), number + 1) for number in range(count)]


def _once(name: str, labelled: set[str]) -> str | None:
    """Return the name as a label the first time, so that the legend has it once."""
    if name in labelled:
        return None
    labelled.add(name)
    return name


def _legend_columns(names: Sequence[str], width: float) -> int:
    """Return how many entries of a legend stand beside each other in `width` inches."""
    longest = max(map(len, names)) + 5
    return max(1, min(len(names), int(15.0 * width / longest)))


def _decades(least: float, most: float) -> tuple[float, float]:
    """Return the powers of ten around these numbers of touches, the lower one 0 for few touches."""
    low = 0.0 if least < _FEW else 10.0 ** floor(log10(least))
    return low, 10.0 ** ceil(log10(max(most, 10.0 * _FEW)))


def _least_gap(values: Sequence[float]) -> float:
    return float(np.diff(values).min()) if len(values) > 1 else 1.0


def _thousands(value: float) -> str:
    return f"{value / 1e6:g}M" if value >= 1e6 else f"{value / 1e3:g}k" if value >= 1e3 else f"{value:g}"
