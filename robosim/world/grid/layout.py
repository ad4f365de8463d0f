"""An arena as the grid sees it: decisions as long as a cell, starts in the middle of cells."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Start, Timing, Zone
from robosim.errors import InputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SHORTEST_DECISION, LONGEST_DECISION = 0.01, 10.0
"""What an arena file allows for the decision period, s."""
LONGEST_CONTROL_PERIOD = 1.0
"""What it allows for the control period, s."""
INSIDE = 1e-6
"""How far inside its cell a place on the border of the source is put, in cells."""


def grid_arena(arena: Arena) -> Arena:
    """Return the arena with the timing, the starts and the places of pellets of the grid.

    A decision takes as long as a cell at top speed. Robots start in the middle of cells, one a cell, so the
    capacity is the number of cells in which they can. Raises InputError where a decision would be longer or
    shorter than an arena file may say.
    """
    period = arena.cell_size / arena.team(1).sheets[0].top_speed
    if not SHORTEST_DECISION <= period <= LONGEST_DECISION:
        raise InputError(
            f"arena {arena.name!r}: cell_size over the robot's top speed, a decision in the grid, is "
            f"{period:g} s; allowed are numbers from {SHORTEST_DECISION:g} to {LONGEST_DECISION:g} s."
        )
    starts, poses = _starts(arena)
    return replace(
        arena,
        timing=Timing(
            decision_period=period,
            control_period=period / math.ceil(period / LONGEST_CONTROL_PERIOD),
            substeps=1,
            episode_steps=arena.timing.episode_steps,
        ),
        start=Start(arena.start.zone, poses),
        start_places=starts,
        capacity=len(starts),
        pellet_places=_frozen(_inside(arena, arena.pellet_places, Zone.SOURCE)),
        as_text=False,
    )


def cells_at(arena: Arena, places: Floats) -> Integers:
    """Return the flat index (row * columns + column) of the cells in which places [..., 2] in m lie."""
    cells = (places * (1.0 / arena.cell_size)).astype(np.int64)
    return np.asarray(cells[..., 1] * arena.columns + cells[..., 0])


def middles(arena: Arena) -> Floats:
    """Return the middle of every cell, [rows * columns, 2] m."""
    rows, columns = np.indices((arena.rows, arena.columns))
    centres: Floats = (np.stack([columns, rows], axis=-1) + np.float64(0.5)) * arena.cell_size
    return centres.reshape(-1, 2)


def _starts(arena: Arena) -> tuple[Floats, tuple[tuple[float, float, float], ...]]:
    """Return the middles of the cells where robots can start, and the given poses moved there."""
    start = arena.start
    places = arena.start_places if start.poses else _inside(arena, arena.start_places, start.zone)
    cells = cells_at(arena, places)
    _, first = np.unique(cells, return_index=True)
    # Of several in one cell the first one counts; the order stays.
    kept = np.sort(first)
    starts = _frozen(middles(arena)[cells[kept]])
    if not start.poses:
        return starts, ()
    headings = [start.poses[index][2] for index in kept.tolist()]
    return starts, tuple((x, y, turn) for (x, y), turn in zip(starts.tolist(), headings, strict=True))


def _inside(arena: Arena, places: Floats, zone: Zone) -> Floats:
    """Return places of a zone, those on its border with another one moved inside."""
    inside = (arena.zones == zone).ravel()
    moved = places.copy()
    nudge = INSIDE * arena.cell_size
    for x in (0.0, -nudge, nudge):
        for y in (0.0, -nudge, nudge):
            near = places + np.array([x, y])
            helps = ~inside[cells_at(arena, moved)] & inside[cells_at(arena, near)]
            moved[helps] = near[helps]
    return moved


def _frozen(places: Floats) -> Floats:
    places.setflags(write=False)
    return places
