"""The map of an arena as text."""

from __future__ import annotations

from robosim.arena.model import ZONE_OF_CHARACTER, Arena, Zone

CHARACTER_OF_ZONE = {zone: character for character, zone in ZONE_OF_CHARACTER.items()}


def drawing(arena: Arena) -> list[str]:
    """Give the map as in the file, top row first."""
    return ["".join(CHARACTER_OF_ZONE[Zone(code)] for code in row) for row in arena.zones[::-1]]
