"""Lists as tables or as JSON, and estimates as they stand in tables."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from robosim.errors import without_controls

if TYPE_CHECKING:
    from rich.console import Console

    from robosim.experiments.statistics import Estimate

_WIDTH_PIPED = 1000
"""Wider than any map or table, so that nothing that is piped is wrapped."""


def console() -> Console:
    """Open a console that colours only for a terminal."""
    from rich.console import Console

    plain: dict[str, Any] = {"highlight": False, "markup": False, "emoji": False}
    own = Console(**plain)
    return own if own.is_terminal else Console(**plain, width=_WIDTH_PIPED)


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows under their headings."""
    from rich.table import Table

    table = Table(*columns, box=None, header_style="bold")
    for row in rows:
        table.add_row(*row)
    console().print(table)


def print_json(rows: Sequence[dict[str, Any]]) -> None:
    """Print a list for other programs: what is in its table, under keys that stay (docs/public.md)."""
    print(json.dumps(rows, indent=2, allow_nan=False))


def written(estimate: Estimate | None, digits: int) -> str:
    """Return an estimate as `value [low, high]`, without an interval where there is none; `-` for none."""
    if estimate is None:
        return "-"
    value = f"{estimate.value:.{digits}f}"
    if estimate.low is None or estimate.high is None:
        return value
    return f"{value} [{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"


def digits_for(values: Sequence[float]) -> int:
    """Return how many decimals tell such values apart: one for pellets, three for shares."""
    return 1 if max(map(abs, values), default=0.0) >= 1.0 else 3


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines with cells below each other; names in them may come from strangers."""
    rows = [list(map(without_controls, row)) for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        ("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))).rstrip()
        for row in rows
    ]


def markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows, the first of which is the heading, as lines of a table in Markdown."""
    heading, *body = ([without_controls(cell).replace("|", "\\|") for cell in row] for row in rows)
    return [f"| {' | '.join(cells)} |" for cells in (heading, ["---"] * len(heading), *body)]
