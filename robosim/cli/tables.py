"""Tables of text, and estimates as they stand in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robosim.experiments.statistics import Estimate


def written(estimate: Estimate | None, digits: int) -> str:
    """Return an estimate as `value [low, high]`, without an interval where there is none; `-` for none."""
    if estimate is None:
        return "-"
    value = f"{estimate.value:.{digits}f}"
    if estimate.low is None or estimate.high is None:
        return value
    return f"{value} [{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines with cells below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        ("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))).rstrip()
        for row in rows
    ]


def markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows, the first of which is the heading, as lines of a table in Markdown."""
    heading, *body = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    return [f"| {' | '.join(cells)} |" for cells in (heading, ["---"] * len(heading), *body)]
