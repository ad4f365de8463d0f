"""Random arenas: maps as a person would draw them, each drawn from a seed and checked as any file is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robosim.arena.load import load_arena
from robosim.errors import InputError, whole_number

ROOM = 32
"""Robots that fit at the start of every random arena as rigid bodies, at least; in the grid fewer may."""
MOST_SEED = 2**63 - 1
LONGEST = 34
"""Of a tunnel along its axis, in cells, about: three times the tunnel of `paper`."""
_CANVAS = 120
_ATTEMPTS = 1000
"""Far more than are needed: two of three drawings fit."""
_CELL_SIZE = 0.15
"""As in the arenas that ship with the standard robot, m."""
_HOME_CELLS = 20
"""Fewest cells of a home for so many robots; the file's check says how many fit."""
_SOURCE_CELLS = 9


class _NoRoomError(Exception):
    """What is to be drawn would touch something else."""


def random_arena(seed: int) -> str:
    """Return the text of the file of a random arena with the standard robot; equal seeds give equal files.

    A home and a source, joined by a tunnel one to three cells wide with up to four bends, some with sidings,
    an island or a second tunnel, turned or mirrored. There is room for at least `ROOM` robots. InputError for
    a seed that is no whole number from 0 to `MOST_SEED`.
    """
    whole_number("seed", seed, 0, MOST_SEED)
    # The kind is drawn once, or kinds that fit less often would be rare.
    kind = _draw_kind(np.random.default_rng(seed))
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(attempt,)))
        try:
            text = _drawn(rng, kind, f"random-{seed}")
            if load_arena(text).capacity >= ROOM:
                return text
        except (_NoRoomError, InputError):
            # The strict reader refuses one now and then, whose source is too small.
            continue
    raise RuntimeError(f"no arena in {_ATTEMPTS} drawings of seed {seed}")


@dataclass(frozen=True, slots=True)
class _Kind:
    """What a map has."""

    width: int
    """Of the tunnel, cells."""
    bends: int
    extra: Literal["", "sidings", "an island", "a second tunnel"]

    def __str__(self) -> str:
        bends = f" with {self.bends} bend{'s' if self.bends > 1 else ''}" if self.bends else ""
        extra = f", {self.extra}" if self.extra else ""
        return f"a tunnel {self.width} wide{bends}{extra}"


def _draw_kind(rng: np.random.Generator) -> _Kind:
    width = int(rng.choice([1, 2, 3], p=[0.4, 0.45, 0.15]))
    bends = int(rng.choice([0, 1, 2, 3, 4], p=[0.3, 0.25, 0.25, 0.15, 0.05]))
    drawn = rng.random()
    if drawn < 0.15:
        # Between chambers that face each other alone.
        return _Kind(width, 0, "a second tunnel")
    return _Kind(width, bends, "sidings" if drawn < 0.35 else "an island" if drawn < 0.55 else "")


def _drawn(rng: np.random.Generator, kind: _Kind, name: str) -> str:
    sketch = _Sketch()
    _draw_map(rng, sketch, kind)
    cells = np.rot90(sketch.cropped(), int(rng.integers(4)))
    if rng.random() < 0.5:
        cells = cells[:, ::-1]
    lines = "\n".join("".join(line) for line in cells)
    return (
        f'name = "{name}"\n'
        f'description = "Drawn at random: {kind}."\n'
        f"cell_size = {_CELL_SIZE}\n"
        f'map = """\n{lines}\n"""\n\n'
        f"[pellets]\ncount = {int(rng.integers(30, 61))}\n"
    )


def _draw_map(rng: np.random.Generator, sketch: _Sketch, kind: _Kind) -> None:
    """Draw home, tunnels and source; _NoRoomError where they would touch."""
    width = kind.width
    home, source = _draw_chamber(rng, width, _HOME_CELLS), _draw_chamber(rng, width, _SOURCE_CELLS)
    place = sketch.put_home(home)
    longest = max(width + 6, LONGEST // (kind.bends + 1))
    legs: list[_Leg] = []
    for bend in range(kind.bends + 1):
        if bend:
            place = place.turned(width, left=rng.random() < 0.5)
        legs.append(_Leg(place, int(rng.integers(width + 2, longest))))
        sketch.add(place, (0, legs[-1].length), (0, width), "T")
        place = place.moved(legs[-1].length)
    sketch.put_source(source, place, width)
    if kind.extra == "sidings":
        for _ in range(int(rng.integers(1, 4))):
            _add_siding(rng, sketch, legs, width)
    elif kind.extra == "an island":
        _add_bypass(rng, sketch, legs, width)
    elif kind.extra == "a second tunnel":
        _add_second(rng, sketch, home, legs[0])


@dataclass(frozen=True, slots=True)
class _Chamber:
    """A home or a source, with the floor between it and the tunnel; lengths in cells."""

    depth: int
    """Of its zone, along the tunnel's axis."""
    floor: int
    """Between zone and tunnel."""
    breadth: int
    offset: int
    """Of the tunnel's right side from the chamber's."""


def _draw_chamber(rng: np.random.Generator, width: int, least_cells: int) -> _Chamber:
    while True:
        depth, floor, breadth = (int(rng.integers(low, high)) for low, high in ((2, 6), (2, 4), (4, 10)))
        if depth * breadth >= least_cells:
            return _Chamber(depth, floor, breadth, int(rng.integers(breadth - width + 1)))


@dataclass(frozen=True, slots=True)
class _Place:
    """A cell and a heading from it: what is drawn there grows ahead and to the left."""

    x: int
    y: int
    ahead: tuple[int, int]

    @property
    def left(self) -> tuple[int, int]:
        return -self.ahead[1], self.ahead[0]

    def moved(self, along: int, across: int = 0) -> _Place:
        """Return the place so many cells ahead and to the left, with the same heading."""
        (ahead_x, ahead_y), (left_x, left_y) = self.ahead, self.left
        return _Place(
            self.x + along * ahead_x + across * left_x, self.y + along * ahead_y + across * left_y, self.ahead
        )

    def turned(self, width: int, *, left: bool) -> _Place:
        """Return where a tunnel of that width goes on after a bend in its last square."""
        corner = self.moved(-1, 0) if left else self.moved(-width, width - 1)
        ahead = self.left if left else (-self.left[0], -self.left[1])
        return _Place(corner.x, corner.y, ahead).moved(width)

    def aside(self, width: int, *, left: bool) -> _Place:
        """Return the place beside a tunnel of that width here, heading away from it."""
        beside = self.moved(0, width if left else -1)
        return _Place(beside.x, beside.y, self.left if left else (-self.left[0], -self.left[1]))


@dataclass(frozen=True, slots=True)
class _Leg:
    """A straight stretch of tunnel."""

    begin: _Place
    length: int


Span = tuple[int, int]
"""First cell and the one after the last."""


@dataclass(slots=True, eq=False)
class _Sketch:
    """A map that is being drawn on a canvas of walls; x grows to the right, y upward."""

    cells: NDArray[np.str_] = field(default_factory=lambda: np.full((_CANVAS, _CANVAS), "#"))
    """[x, y]."""

    def put_home(self, home: _Chamber) -> _Place:
        """Draw the home amid the canvas; returns where the tunnel begins."""
        corner = _Place(_CANVAS // 2, _CANVAS // 2, (1, 0))
        self.fill(corner, (0, home.depth), (0, home.breadth), "H")
        depth = home.depth + home.floor
        self.fill(corner, (home.depth, depth), (0, home.breadth), ".")
        return corner.moved(depth, home.offset)

    def put_source(self, source: _Chamber, place: _Place, width: int) -> None:
        """Draw the source where the tunnel ends."""
        corner = place.moved(0, -source.offset)
        # Beside the tunnel's end, too: the chamber's near side is a wall.
        for first, last in ((-1, source.offset), (source.offset + width, source.breadth + 1)):
            self.require_wall(corner, (-1, 0), (first, last))
        self.add(corner, (0, source.floor), (0, source.breadth), ".")
        self.add(corner.moved(source.floor), (0, source.depth), (0, source.breadth), "S")

    def add(self, place: _Place, along: Span, across: Span, zone: str) -> None:
        """Draw a rectangle that touches nothing but what is behind it."""
        self.require_wall(place, (along[0], along[1] + 1), (across[0] - 1, across[1] + 1))
        self.fill(place, along, across, zone)

    def cropped(self) -> NDArray[np.str_]:
        """Return the map [rows, columns] with a border of walls, the top row first."""
        free = np.argwhere(self.cells != "#")
        (x0, y0), (x1, y1) = free.min(axis=0) - 1, free.max(axis=0) + 2
        return self.cells[x0:x1, y0:y1].T[::-1]

    def fill(self, place: _Place, along: Span, across: Span, zone: str) -> None:
        """Draw a rectangle over whatever is there."""
        self.cells[self.at(place, along, across)] = zone

    def require_wall(self, place: _Place, along: Span, across: Span) -> None:
        """Raise _NoRoomError unless a rectangle is wall."""
        if (self.cells[self.at(place, along, across)] != "#").any():
            raise _NoRoomError

    def at(self, place: _Place, along: Span, across: Span) -> tuple[slice, slice]:
        """Return the cells of a rectangle; _NoRoomError where it leaves the canvas."""
        one, other = place.moved(along[0], across[0]), place.moved(along[1] - 1, across[1] - 1)
        x, y = sorted((one.x, other.x)), sorted((one.y, other.y))
        if min(x[0], y[0]) < 1 or max(x[1], y[1]) > _CANVAS - 2:
            raise _NoRoomError
        return slice(x[0], x[1] + 1), slice(y[0], y[1] + 1)


def _add_siding(rng: np.random.Generator, sketch: _Sketch, legs: list[_Leg], width: int) -> None:
    """Add a pocket beside the tunnel, one or two cells deep and up to three long."""
    leg = legs[int(rng.integers(len(legs)))]
    long, deep = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    sketch.add(_beside(rng, leg, width, long), (0, deep), (0, long), "T")


def _add_bypass(rng: np.random.Generator, sketch: _Sketch, legs: list[_Leg], width: int) -> None:
    """Add a second way round an island of walls beside the longest stretch."""
    leg = max(legs, key=lambda one: one.length)
    lane, thick = int(rng.integers(1, 3)), int(rng.integers(1, 4))
    long = 2 * lane + int(rng.integers(1, 7))
    place = _beside(rng, leg, width, long)
    sketch.add(place, (0, thick + lane), (0, long), "T")
    sketch.fill(place, (0, thick), (lane, long - lane), "#")


def _beside(rng: np.random.Generator, leg: _Leg, width: int, long: int) -> _Place:
    """Return a random place beside a leg with `long` cells of it to the left, heading away from the leg."""
    if leg.length < long + 2:
        raise _NoRoomError
    first, left = int(rng.integers(1, leg.length - long)), rng.random() < 0.5
    # Whoever looks away to the left of a heading has what lay ahead to the right.
    return leg.begin.moved(first + long - 1 if left else first).aside(width, left=left)


def _add_second(rng: np.random.Generator, sketch: _Sketch, home: _Chamber, leg: _Leg) -> None:
    """Add a second straight tunnel from home to source, beside the first."""
    width = int(rng.integers(1, 3))
    place = leg.begin.moved(0, int(rng.integers(home.breadth - width + 1)) - home.offset)
    sketch.require_wall(place, (0, leg.length), (-1, width + 1))
    if (sketch.cells[sketch.at(place, (leg.length, leg.length + 1), (0, width))] == "#").any():
        raise _NoRoomError
    sketch.fill(place, (0, leg.length), (0, width), "T")
