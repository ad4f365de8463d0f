"""Write a policy as a folder of flat files for the Robotarium (Wilson 2020), www.robotarium.gatech.edu.

The code in it is robosim's own, flattened (`bundle`), not written anew: so what decides there is what decided
in training. All that is derived from the arena (distances, places of pellets) is stored with it.
"""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import robosim
from robosim.arena import Arena, parse_arena
from robosim.arena.model import Zone
from robosim.control.card import PolicyCard
from robosim.control.policy import WEIGHTS_FILE, read_policy
from robosim.deploy.robotarium.bundle import flat_files
from robosim.deploy.robotarium.experiment import ARRAYS, LEAST_APART, SETTINGS, TURN
from robosim.deploy.robotarium.floor import VirtualFloor
from robosim.errors import InputError
from robosim.robot.sheet import RobotSheet

Floats = NDArray[np.float64]

MOST_ROBOTS = 20
LONGEST = 900.0
"""Time that an experiment may take, s."""
FLOOR = (3.2, 2.0)
"""m."""
MOST_APART = 0.3
"""Barrier certificates that keep robots further apart would fill the floor, m."""
_START_CLEAR = 0.06
"""The laboratory's own controller brings robots to within 0.05 m of where they are to begin, m."""
_START_APART = 0.4
"""Its barrier certificates let nobody's nose within 0.25 m of another's on the way, and it waits for ever for
robots that are to begin nearer than that, m."""
_START_TRIES = 1000
_OFF_TURNS = 0.05
"""How far a control period may be from a whole number of turns, as a share."""


def robotarium_files(
    folder: Path, name: str = "", *, seconds: float = LONGEST, apart: float = 0.0, seed: int = 0
) -> dict[str, bytes]:
    """Return the files of an experiment with the policy in `folder`, by their names.

    It takes `seconds`; barrier certificates of the laboratory keep robots' centres `apart` (m), or none are
    used (0). `seed` draws where robots begin and pellets lie. InputError, in one sentence, for a policy that
    is not for that laboratory's robots or floor, and for a folder that is not a whole, sound policy.
    """
    policy = read_policy(folder)
    card = policy.card
    name = name or folder.resolve().name
    arena = parse_arena(card.env.arena, "env.arena")
    _require_numbers(seconds, apart)
    _require_fit(card, arena, f"policy {name}")
    origin = _origin(arena)
    weights = {key: array.astype(card.network.precision) for key, array in policy.weights().items()}
    settings = {
        "robosim": robosim.__version__,
        "policy": name,
        "weights_sha256": hashlib.sha256((folder / WEIGHTS_FILE).read_bytes()).hexdigest(),
        "robots": card.robots,
        "seconds": seconds,
        "apart": apart,
        "seed": seed,
        "show_figure": True,
        "sim_in_real_time": True,
        "origin": origin.tolist(),
        "starts": _on_floor(_starts(arena, card.robots, seed), origin).tolist(),
        "arena": _arena_table(arena),
        "layout": asdict(card.env.layout_in(arena)),
        "keep_distance": card.env.keep_distance,
        "pheromone": card.env.pheromone.model_dump(),
        "network": card.network.model_dump(),
        "columns": card.columns,
    }
    files = {
        file: text.encode() for file, text in flat_files("robosim.deploy.robotarium.main", "main.py").items()
    }
    files[SETTINGS] = (json.dumps(settings, indent=1) + "\n").encode()
    files[ARRAYS] = _packed(weights | _arena_arrays(arena))
    return files


def _require_numbers(seconds: float, apart: float) -> None:
    if not TURN <= seconds <= LONGEST:
        raise InputError(f"seconds is {seconds:g}, but must be from {TURN:g} to {LONGEST:g}.")
    if apart and not LEAST_APART <= apart <= MOST_APART:
        raise InputError(
            f"barrier is {apart:g}, but must be from {LEAST_APART:g} to {MOST_APART:g} (m), or 0 for none."
        )


def _require_fit(card: PolicyCard, arena: Arena, who: str) -> None:
    """Raise InputError unless robots, floor and periods are those of the laboratory."""
    if card.robots > MOST_ROBOTS:
        raise InputError(f"{who} drives {card.robots} robots, but the Robotarium has {MOST_ROBOTS}.")
    if arena.groups:
        raise InputError(f"{who} drives a mixed team, but the Robotarium's robots are all alike.")
    theirs = RobotSheet()
    for field in ("shape", "length", "width", "wheel_radius", "wheel_base", "max_wheel_speed"):
        ours, right = getattr(arena.robot, field), getattr(theirs, field)
        if ours != right:
            raise InputError(f"{who} drives robots of {field} {ours}, but the Robotarium's have {right}.")
    if not card.robots <= arena.capacity:
        raise InputError(f"{who} drives {card.robots} robots, but its arena has room for {arena.capacity}.")
    low, high = _free_box(arena)
    size = high - low
    # By a hair, since sizes of cells are not exact in binary.
    if (size > np.array(FLOOR) + 1e-9).any():
        raise InputError(
            f"{who} needs {size[0]:.2f} x {size[1]:.2f} m between its walls (arena {arena.name!r}), but the "
            f"Robotarium's floor is {FLOOR[0]:g} x {FLOOR[1]:g} m."
        )
    period = arena.timing.control_period
    turns = round(period / TURN)
    if turns < 1 or abs(turns * TURN - period) > _OFF_TURNS * period:
        raise InputError(
            f"{who} has a control period of {period:g} s, but it must be within {_OFF_TURNS:.0%} of a whole "
            f"number of the Robotarium's turns of {TURN:g} s."
        )


def _free_box(arena: Arena) -> tuple[Floats, Floats]:
    """Return the corners of the smallest box that holds all free cells, m."""
    rows, columns = np.nonzero(arena.zones != Zone.WALL)
    low = np.array([columns.min(), rows.min()]) * arena.cell_size
    high = np.array([columns.max() + 1, rows.max() + 1]) * arena.cell_size
    return low, high


def _origin(arena: Arena) -> Floats:
    """Return where the map's corner lies when its free cells are in the middle of the floor, m."""
    low, high = _free_box(arena)
    return np.asarray(-0.5 * (low + high))


def _on_floor(pose: Floats, origin: Floats) -> Floats:
    """Return poses [robots, 3] on the map as the laboratory counts them."""
    return np.asarray(pose + np.append(origin, 0.0))


def _starts(arena: Arena, robots: int, seed: int) -> Floats:
    """Return poses [robots, 3] on the map at which the arena lets robots begin.

    Of a thousand draws of its start places the first with room enough for the laboratory's controller, which
    brings robots there, or else the one with most; all head east, so that noses are no nearer than centres.
    """
    if arena.start.poses:
        return np.array(arena.start.poses[:robots])
    rng = np.random.default_rng(seed)
    floor = VirtualFloor(arena, robots, seed)
    clear = floor.clearance(arena.start_places) >= arena.robot.outer_radius + _START_CLEAR
    places = arena.start_places[clear] if clear.sum() >= robots else arena.start_places
    draws = np.stack([rng.permutation(len(places))[:robots] for _ in range(_START_TRIES)])
    drawn = places[draws]
    apart = np.linalg.norm(drawn[:, :, None] - drawn[:, None], axis=-1)
    apart[:, np.arange(robots), np.arange(robots)] = np.inf
    room = apart.min(axis=(1, 2))
    # The first with room enough, so that starts stay as random as there is room for.
    enough = room >= _START_APART
    best = int(enough.argmax() if enough.any() else room.argmax())
    return np.column_stack([drawn[best], np.zeros(robots)])


def _arena_table(arena: Arena) -> dict[str, Any]:
    distances = arena.distances
    return {
        "name": arena.name,
        "cell_size": arena.cell_size,
        "tunnel_length": arena.tunnel_length,
        "robot": asdict(arena.robot),
        "pellets": asdict(arena.pellets),
        "timing": asdict(arena.timing),
        "distances": {
            field.name: getattr(distances, field.name)
            for field in fields(distances)
            if not isinstance(getattr(distances, field.name), np.ndarray)
        },
    }


def _arena_arrays(arena: Arena) -> dict[str, NDArray[Any]]:
    distances = arena.distances
    arrays: dict[str, NDArray[Any]] = {
        f"distances.{field.name}": getattr(distances, field.name)
        for field in fields(distances)
        if isinstance(getattr(distances, field.name), np.ndarray)
    }
    return arrays | {"zones": arena.zones, "walls": arena.walls, "pellet_places": arena.pellet_places}


def _packed(arrays: dict[str, NDArray[Any]]) -> bytes:
    packed = io.BytesIO()
    # In an order of their own: files of weights have none.
    ordered: dict[str, Any] = {name: arrays[name] for name in sorted(arrays)}
    np.savez_compressed(packed, **ordered)
    return packed.getvalue()
