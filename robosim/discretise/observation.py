"""What a robot observes: its own eight numbers, and the pheromones around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from robosim.discretise.cells import NEIGHBOURS
from robosim.discretise.modes import Mode
from robosim.discretise.own_frame import SIDES
from robosim.discretise.pheromone import CHANNELS, Seen
from robosim.equality import EqualByValue
from robosim.robot.drivers import ACTION_NAMES, ActionKind

Encoding = Literal["paper", "expanded"]
ENCODINGS: tuple[Encoding, ...] = ("paper", "expanded")
COLLISIONS_FULL = 20
"""Collisions since the last change of mode at which that number is 1 and stays there."""
IN_PLACE_CYCLE = 20
"""Decisions without displacement after which that number begins anew: a policy that answers every observation
with one action stands still for ever once nothing that it observes changes, so one number always does."""
IN_PLACE = "in place"
"""Name of that number in an observation: the decisions of the cycle so far, as a share of it."""
LADEN = "laden"
"""Name of the number that is 1 for a robot that carries a pellet, or else 0."""
STANDING = 0.5
"""The least of it at which a robot counts as standing: in the second half of every cycle."""
_Array = TypeVar("_Array", bound=Any)
_COMPASS = ("N", "S", "W", "E", "NW", "NE", "SW", "SE")


@dataclass(frozen=True)
class ObservationLayout:
    """Which number stands where in an observation; policies carry it to be checked against."""

    encoding: Encoding
    stigmergy: bool
    actions: ActionKind
    radius: int
    """Field of view of the pheromone patch, cells; without meaning when `stigmergy` is off."""
    seen: Seen = "all"
    """What of the pheromone map is in it; without meaning when `stigmergy` is off."""
    neighbours: bool = True
    """Whether the expanded encoding says which neighbouring cells are free."""
    kinds: tuple[str, ...] = ()
    """Groups of a mixed team, in one of which each robot is; empty for a team of equals."""

    @property
    def patch(self) -> bool:
        """Whether the pheromones of the cells around the robot are in it."""
        return self.stigmergy and self.seen != "density"

    @property
    def density(self) -> bool:
        """Whether the tunnel density is in it, as its last number."""
        return self.stigmergy and self.seen != "patch"

    @property
    def num_actions(self) -> int:
        """Actions that a robot chooses from."""
        return len(ACTION_NAMES[self.actions])

    @property
    def own_frame(self) -> bool:
        """Whether sides are the robot's own, ahead to right, and not the map's, north to east."""
        return self.actions != "cardinal" and self.encoding == "expanded"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of every number, in order."""
        if self.encoding == "paper":
            own = ["mode", "x", "y", "heading", "previous action", "collisions"]
        else:
            own = [f"mode {mode.name.lower()}" for mode in Mode]
            own += ["x", "y", "heading sine", "heading cosine"]
            own += [f"previous action {name}" for name in ACTION_NAMES[self.actions]]
            own += ["collisions"]
        own += ["distance to home", "distance to source"]
        if self.encoding == "expanded":
            own += ["offset in cell x", "offset in cell y", LADEN]
            sides = SIDES if self.own_frame else _COMPASS
            own += [f"free {side}" for side in sides if self.neighbours]
            own += [f"gain home {side}" for side in sides[:4]]
            own += [f"gain source {side}" for side in sides[:4]]
            axes = ("ahead", "left") if self.own_frame else ("x", "y")
            own += ["pellet seen", *(f"pellet {axis}" for axis in axes), IN_PLACE]
        own += [f"kind {kind}" for kind in self.kinds]
        if self.patch:
            side = range(-self.radius, self.radius + 1)
            own += [
                f"{channel} ({row:+d} ahead, {-column:+d} left)"
                if self.own_frame
                else f"{channel} ({column:+d}, {row:+d})"
                for channel in CHANNELS
                for row in reversed(side)
                for column in side
            ]
        if self.density:
            own += ["tunnel density"]
        return tuple(own)

    @cached_property
    def size(self) -> int:
        """Numbers in an observation."""
        return len(self.names)

    @cached_property
    def low(self) -> NDArray[np.float32]:
        """[size] lower bounds."""
        signed = {"heading", "heading sine", "heading cosine", "offset in cell x", "offset in cell y"}
        signed |= {"pellet x", "pellet y", "pellet ahead", "pellet left"}
        return np.array(
            [-1.0 if name in signed or name.startswith("gain") else 0.0 for name in self.names],
            dtype=np.float32,
        )

    @cached_property
    def high(self) -> NDArray[np.float32]:
        """[size] upper bounds."""
        return np.ones(self.size, dtype=np.float32)


class MoveGains(NamedTuple):
    """Where an observation holds the gains of moves, which are the first of the actions."""

    home: int
    """Where the gains toward home begin, in the order of the moves."""
    source: int
    moves: int
    """How many of the actions are moves: N, S, W and E, or forward and back."""


def gain_columns(names: Sequence[str], actions: ActionKind) -> MoveGains | None:
    """Return where the gains of moves are in an observation, the numbers of which have these `names`.

    None where it does not hold them.
    """
    sides, moves = (_COMPASS, 4) if actions == "cardinal" else (SIDES, 2)
    home, source = ([f"gain {goal} {side}" for side in sides[:moves]] for goal in ("home", "source"))
    first = [names.index(gains[0]) if gains[0] in names else len(names) for gains in (home, source)]
    columns = MoveGains(first[0], first[1], moves)
    held = [list(names[start : start + moves]) for start in first]
    return columns if held == [home, source] else None


class Columns(NamedTuple):
    """Where an observation holds what policies go by besides networks; None for what it does not hold."""

    gains: MoveGains | None = None
    in_place: int | None = None
    """Of the number `IN_PLACE`."""
    laden: int | None = None
    """Of the number `LADEN`."""


NO_COLUMNS = Columns()


def find_columns(names: Sequence[str], actions: ActionKind) -> Columns:
    """Return where all of that is in an observation, the numbers of which have these `names`."""
    in_place, laden = (names.index(name) if name in names else None for name in (IN_PLACE, LADEN))
    return Columns(gain_columns(names, actions), in_place, laden)


def standing(observation: NDArray[np.float32], in_place: int) -> NDArray[np.bool_]:
    """Return which robots [...] have stood for a while, by number `in_place` of `observation` [..., size]."""
    stands: NDArray[np.bool_] = observation[..., in_place] >= np.float32(STANDING)
    return stands


def blocked_moves(observation: _Array, columns: MoveGains) -> _Array:
    """Return which of the moves are blocked, [..., moves], for `observation` [..., size].

    A move is blocked when it loses a whole cell toward both goals: it ends at a wall, or leads straight away
    from all that there is to do. `columns` come from `gain_columns`; numpy arrays and torch tensors serve.
    """
    home, source, moves = columns
    blocked: _Array = (observation[..., home : home + moves] <= -1.0) & (
        observation[..., source : source + moves] <= -1.0
    )
    return blocked


def mask_blocked_moves(
    values: NDArray[np.float32], observation: NDArray[np.float32], columns: MoveGains | None
) -> NDArray[np.float32]:
    """Set the values [..., actions] of blocked moves to minus infinity, in place, and return them.

    `observation` is [..., size]; `columns` come from `gain_columns`, and without them no move is blocked.
    """
    if columns is not None:
        values[..., : columns.moves][blocked_moves(observation, columns)] = -np.inf
    return values


@dataclass(frozen=True, slots=True, eq=False)
class OwnState(EqualByValue):
    """What the encodings are made of; arrays are [envs, robots] unless said otherwise."""

    mode: NDArray[np.uint8]
    """With collisions overlaid."""
    laden: NDArray[np.bool_]
    position: NDArray[np.float64]
    """[envs, robots, 2] over the arena's size, 0 to 1."""
    heading: NDArray[np.float64]
    """rad."""
    offset: NDArray[np.float64]
    """[envs, robots, 2] from the cell's centre, -1 to 1 at its sides."""
    previous_action: NDArray[np.int64]
    collisions: NDArray[np.int64]
    """Since the last change of mode."""
    distances: NDArray[np.float64]
    """[envs, robots, 2] to home and source over the largest in the arena, 0 to 1."""
    in_place: NDArray[np.int64]
    """Decisions without displacement."""
    free_neighbours: NDArray[np.bool_] | None
    """[envs, robots, 8] neither wall nor robot; only an expanded encoding with `neighbours` needs it."""
    gain: NDArray[np.float64] | None
    """[envs, robots, 8] how much nearer the cells to N, S, W and E are to home, and then to the source, in
    cells, -1 for walls; only the expanded encoding needs it."""
    pellet: NDArray[np.float64] | None
    """[envs, robots, 3] whether a loose pellet lies within sight, and where from the robot's centre, in
    units of the sight; only the expanded encoding needs it."""
    kind: NDArray[np.float32] | None = None
    """[robots, kinds] 1 for a robot's own; only a layout with kinds needs it."""


_MODE_CODES = np.eye(len(Mode), dtype=np.float32)
_ACTION_CODES = {kind: np.eye(len(names), dtype=np.float32) for kind, names in ACTION_NAMES.items()}


def write_own_state(layout: ObservationLayout, own: OwnState, out: NDArray[np.float32]) -> int:
    """Write the numbers of `own` into `out` [envs, robots, size]; returns how many there are.

    `paper` gives the mode as one number in 0 to 1; `expanded` gives one-hot codes, sine and cosine.
    """
    end = _write_encoded(layout, own, out)
    if layout.kinds:
        out[..., end : end + len(layout.kinds)] = own.kind
    return end + len(layout.kinds)


def _write_encoded(layout: ObservationLayout, own: OwnState, out: NDArray[np.float32]) -> int:
    crowd = np.minimum(own.collisions * (1.0 / COLLISIONS_FULL), 1.0)
    if layout.encoding == "paper":
        out[..., 0] = own.mode * (1.0 / (len(Mode) - 1))
        out[..., 1:3] = own.position
        out[..., 3] = own.heading * (1.0 / np.pi)
        out[..., 4] = own.previous_action * (1.0 / (layout.num_actions - 1))
        out[..., 5] = crowd
        out[..., 6:8] = own.distances
        return 8
    out[..., 0:7] = _MODE_CODES.take(own.mode, axis=0)
    out[..., 7:9] = own.position
    out[..., 9] = np.sin(own.heading)
    out[..., 10] = np.cos(own.heading)
    end = 11 + layout.num_actions
    out[..., 11:end] = _ACTION_CODES[layout.actions].take(own.previous_action, axis=0)
    out[..., end] = crowd
    out[..., end + 1 : end + 3] = own.distances
    out[..., end + 3 : end + 5] = own.offset
    out[..., end + 5] = own.laden
    end += 6
    if layout.neighbours:
        out[..., end : end + len(NEIGHBOURS)] = own.free_neighbours
        end += len(NEIGHBOURS)
    out[..., end : end + 8] = own.gain
    out[..., end + 8 : end + 11] = own.pellet
    out[..., end + 11] = own.in_place % IN_PLACE_CYCLE * (1.0 / IN_PLACE_CYCLE)
    return end + 12
