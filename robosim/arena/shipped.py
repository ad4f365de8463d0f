"""Where data that comes with robosim lies: arenas, policies, profiles."""

from __future__ import annotations

from pathlib import Path

from robosim.errors import InputError

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped_folder(kind: str) -> Path:
    """Return the folder of shipped data of one kind ("arenas", "policies" or "profiles").

    An installed package carries it inside itself; a source checkout has it beside the package.
    """
    places = (_PACKAGE / "_data" / kind, _PACKAGE.parent / kind)
    for place in places:
        if place.is_dir():
            return place
    raise InputError(
        f"robosim was installed without its {kind}: neither {places[0]} nor {places[1]} is there."
    )


def shipped_names(kind: str) -> list[str]:
    """Return the names of the TOML files of one kind that ship, sorted."""
    return sorted(path.stem for path in shipped_folder(kind).glob("*.toml"))
