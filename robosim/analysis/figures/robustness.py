"""The figure of robustness: the share of pellets kept against the size of each noise."""

from __future__ import annotations

from math import ceil

from matplotlib.figure import Figure

from robosim.analysis.figures.style import FAINT, LADEN, PAGE, QUIET, UNLADEN
from robosim.analysis.robustness import JAMMED, Robustness

_COLUMNS = 4
_PANEL_HEIGHT = 1.6


def draw_robustness(found: Robustness) -> Figure:
    """Draw a panel for each noise; a line at the size at which the team jams, where it does at one."""
    rows = ceil(len(found.curves) / _COLUMNS)
    figure = Figure(figsize=(PAGE, 0.4 + rows * _PANEL_HEIGHT))
    for number, curve in enumerate(found.curves):
        axes = figure.add_subplot(rows, min(_COLUMNS, len(found.curves)), number + 1)
        sizes = [0.0, *(level.size for level in curve.levels)]
        shares = [1.0, *(level.share for level in curve.levels)]
        errors = [0.0, *(level.error for level in curve.levels)]
        axes.axhline(JAMMED, color=FAINT, linewidth=0.8, zorder=0)
        axes.axhline(1.0, color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
        if curve.jams_at is not None:
            axes.axvline(curve.jams_at, color=LADEN, linewidth=1.2, linestyle=(0, (1, 1.5)))
        axes.errorbar(sizes, shares, yerr=errors, color=UNLADEN, linewidth=1.0, marker="o", markersize=3.0)
        axes.set_title(curve.noise)
        axes.set_xlabel(curve.unit)
        axes.set_ylim(0.0, max(1.1, 1.05 * max(map(sum, zip(shares, errors, strict=True)))))
        axes.set_xlim(left=0.0)
    figure.supylabel("share of the pellets kept", fontsize=8.0)
    return figure
