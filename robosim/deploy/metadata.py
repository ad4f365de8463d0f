"""What an exported policy says of itself: all that is needed to feed it, and to obey it."""

from __future__ import annotations

import json
import math
from dataclasses import asdict

import robosim
from robosim.arena import parse_arena
from robosim.arena.model import Arena
from robosim.control.card import PolicyCard
from robosim.discretise.dec_pomdp import SIGHT
from robosim.discretise.goals import Goals
from robosim.discretise.modes import Mode
from robosim.discretise.observation import COLLISIONS_FULL, IN_PLACE_CYCLE
from robosim.robot.drivers import ACTION_NAMES
from robosim.robot.sheet import RobotSheet


def metadata(card: PolicyCard, name: str, weights_sha256: str) -> dict[str, str]:
    """Return the metadata of an exported policy: texts, most of them JSON, by their names.

    `weights_sha256` is the SHA-256 of the policy's file of weights.
    """
    arena = card.arena
    actions = ACTION_NAMES[card.env.actions]
    return {
        "robosim": robosim.__version__,
        "policy": name,
        "observation": json.dumps(number_meanings(card)),
        "actions": json.dumps(actions if len(actions) == card.network.actions else []),
        "decision_period": repr(arena.timing.decision_period),
        "control_period": repr(arena.timing.control_period),
        "robot": json.dumps(robot_limits(card)),
        "weights_sha256": weights_sha256,
        "card": card.model_dump_json(),
    }


Limits = dict[str, float | str]
"""A data sheet in SI units, with the top speeds that follow from it."""


def robot_limits(card: PolicyCard) -> Limits | list[Limits]:
    """Return the robot's data sheet, or in a mixed team one for each robot, by number."""
    arena = parse_arena(card.env.arena, "env.arena")
    if not arena.groups:
        return _limits(arena.robot)
    return [_limits(sheet) for sheet in arena.team(card.robots).sheets]


def _limits(sheet: RobotSheet) -> Limits:
    return {**asdict(sheet), "top_speed": sheet.top_speed, "top_turn_rate": sheet.top_turn_rate}


def number_meanings(card: PolicyCard) -> list[dict[str, str | float]]:
    """Return what each number of an observation is, in order: `name`, `unit` and `scale`.

    A number times its scale is in its unit; flags, codes and marks have the unit "1".
    """
    units = _Units(card, parse_arena(card.env.arena, "env.arena"))
    meanings: list[dict[str, str | float]] = []
    for name in card.observation:
        unit, scale = units.of(name)
        meanings.append({"name": name, "unit": unit, "scale": scale})
    return meanings


class _Units:
    """The units of an observation's numbers in one arena, by their names."""

    def __init__(self, card: PolicyCard, arena: Arena) -> None:
        width, height = arena.size
        farthest = Goals(arena, arena.team(card.robots)).farthest
        cell = arena.cell_size
        sight = SIGHT * cell
        self._exact: dict[str, tuple[str, float]] = {
            "mode": ("index", len(Mode) - 1.0),
            "x": ("m", width),
            "y": ("m", height),
            "heading": ("rad", math.pi),
            "previous action": ("index", card.network.actions - 1.0),
            "collisions": ("collisions", float(COLLISIONS_FULL)),
            "distance to home": ("m", farthest),
            "distance to source": ("m", farthest),
            "offset in cell x": ("m", 0.5 * cell),
            "offset in cell y": ("m", 0.5 * cell),
            "pellet x": ("m", sight),
            "pellet y": ("m", sight),
            "pellet ahead": ("m", sight),
            "pellet left": ("m", sight),
            "in place": ("decisions", float(IN_PLACE_CYCLE)),
            "tunnel density": ("robots per cell of the tunnel's length", 1.0),
        }
        self._begins: dict[str, tuple[str, float]] = {
            "gain ": ("m", cell),
            "occupancy ": ("pheromone", card.env.pheromone.saturation),
        }

    def of(self, name: str) -> tuple[str, float]:
        """Return unit and scale of the number with this name."""
        for begin, meaning in self._begins.items():
            if name.startswith(begin):
                return meaning
        return self._exact.get(name, ("1", 1.0))
