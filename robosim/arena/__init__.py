"""Arenas: the map, its walls and zones, and the distances along it."""

from robosim.arena.load import arena_names, load_arena
from robosim.arena.model import Arena, PelletSheet, Randomisation, Start, Timing, Zone
from robosim.arena.parse import parse_arena

__all__ = [
    "Arena",
    "PelletSheet",
    "Randomisation",
    "Start",
    "Timing",
    "Zone",
    "arena_names",
    "load_arena",
    "parse_arena",
]
