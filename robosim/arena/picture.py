"""A picture of an arena as SVG, for notebooks: a path a zone, and robots where they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.html import facts_html

Colour = tuple[int, int, int]
ZONE_COLOURS: dict[Zone, Colour] = {
    Zone.WALL: (74, 80, 92),
    Zone.FLOOR: (240, 240, 236),
    Zone.HOME: (212, 236, 214),
    Zone.SOURCE: (246, 224, 196),
    Zone.TUNNEL: (218, 226, 238),
    Zone.HANDOVER: (238, 218, 236),
}
_LONG_SIDE = 480
"""Pixels along the longer side."""
_MOST_RUNS = 5000
"""Stretches of equal cells that are drawn: a map from a stranger may have 40,000."""


def arena_html(arena: Arena) -> str:
    """Return what an arena shows of itself in a notebook."""
    width, height = arena.size
    facts = [
        ("description", arena.description),
        (
            "size",
            f"{width:.2f} x {height:.2f} m, {arena.columns} x {arena.rows} cells of {arena.cell_size:g} m",
        ),
        ("tunnel", f"{arena.tunnel_length} cells"),
        ("robots", f"at most {arena.capacity} at the start"),
        ("pellets", arena.pellets.count),
        ("episode", f"{arena.timing.episode_steps} decisions of {arena.timing.decision_period:g} s"),
        ("file", arena.file),
    ]
    return facts_html(f"arena {arena.name}", facts, arena_svg(arena))


def arena_svg(arena: Arena, marks: str = "") -> str:
    """Return the map, a unit a cell and the first row at the top, with `marks` (SVG) on it.

    Nothing for a map that is too ragged to be drawn in little.
    """
    paths, runs = [], 0
    for zone, colour in ZONE_COLOURS.items():
        rows, starts, lengths = _runs(arena.zones[::-1] == zone)
        runs += len(rows)
        outline = "".join(f"M{x} {y}h{n}v1h-{n}z" for y, x, n in zip(rows, starts, lengths, strict=True))
        if outline:
            paths.append(f'<path fill="{css(colour)}" d="{outline}"/>')
    if runs > _MOST_RUNS:
        return ""
    scale = _LONG_SIDE / max(arena.rows, arena.columns)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" style="display:block" shape-rendering="crispEdges" '
        f'width="{round(arena.columns * scale)}" height="{round(arena.rows * scale)}" '
        f'viewBox="0 0 {arena.columns} {arena.rows}">{"".join(paths)}{marks}</svg>'
    )


def css(colour: Colour) -> str:
    """Return a colour as style sheets and SVG write it."""
    return f"rgb({','.join(map(str, colour))})"


def _runs(cells: NDArray[np.bool_]) -> tuple[list[int], list[int], list[int]]:
    """Return row, first column and length of every stretch of marked cells of a row."""
    edges = np.diff(np.pad(cells.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(edges == 1)
    _, ends = np.nonzero(edges == -1)
    return rows.tolist(), starts.tolist(), (ends - starts).tolist()
