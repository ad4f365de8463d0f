"""The figure of robustness: the share of pellets kept against the size of each noise."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robosim.analysis.figures.style import FAINT, PAGE, QUIET, SERIES
from robosim.analysis.robustness import JAMMED, Curve, Robustness

MOST_TEAMS = len(SERIES)
"""Side by side in one figure: more could not be told apart."""
_COLUMNS = 4
_PANEL_HEIGHT = 1.6
_LEGEND_HEIGHT = 0.3


def draw_robustness(teams: Sequence[Robustness]) -> Figure:
    """Draw a panel for each noise, with a curve for each of up to `MOST_TEAMS` teams.

    A dotted line is at the size at which a team jams, where it does at one.
    """
    units = {curve.noise: curve.unit for found in teams for curve in found.curves}
    rows = ceil(len(units) / _COLUMNS)
    legend = _LEGEND_HEIGHT if len(teams) > 1 else 0.0
    height = 0.4 + rows * _PANEL_HEIGHT + legend
    figure = Figure(figsize=(PAGE, height))
    for number, (noise, unit) in enumerate(units.items()):
        axes = figure.add_subplot(rows, min(_COLUMNS, len(units)), number + 1)
        axes.axhline(JAMMED, color=FAINT, linewidth=0.8, zorder=0)
        axes.axhline(1.0, color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
        top = 1.1
        for found, colour in zip(teams, SERIES, strict=False):
            for curve in found.curves:
                if curve.noise == noise:
                    top = max(top, _draw_curve(axes, curve, found, colour))
        axes.set_title(noise)
        axes.set_xlabel(unit)
        axes.set_ylim(0.0, top)
        axes.set_xlim(left=0.0)
    figure.supylabel("share of the pellets kept", fontsize=8.0)
    if legend:
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=min(3, len(teams)), frameon=False)
    return figure


def _draw_curve(axes: Axes, curve: Curve, found: Robustness, colour: str) -> float:
    """Draw the curve of one team; returns how high the panel must be for it."""
    sizes = [level.size for level in curve.levels]
    shares = [level.share for level in curve.levels]
    errors = [level.error for level in curve.levels]
    if found.profile is None:
        # Under a profile a team without more noise is not one without any.
        sizes, shares, errors = [0.0, *sizes], [1.0, *shares], [0.0, *errors]
    if curve.jams_at is not None:
        axes.axvline(curve.jams_at, color=colour, linewidth=1.2, linestyle=(0, (1, 1.5)))
    axes.errorbar(
        sizes,
        shares,
        yerr=errors,
        color=colour,
        linewidth=1.0,
        marker="o",
        markersize=3.0,
        label=_label(found),
    )
    return 1.05 * max(share + error for share, error in zip(shares, errors, strict=True))


def _label(found: Robustness) -> str:
    return f"{found.controller} ({sum(found.delivered) / len(found.delivered):.1f} pellets)"
