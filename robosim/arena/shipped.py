"""Where data that comes with robosim lies (arenas, policies, profiles), and reading texts of that kind."""

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


def read_text(path: Path, what: str, itself: str, most: int) -> str:
    """Return the text of a file of at most so many bytes; InputError in one sentence where it is none.

    `what` and `itself` are what the sentence calls it: "arena file", "the arena file".
    """
    one = f"an {what}" if what[0] in "aeiou" else f"a {what}"
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)
    except IsADirectoryError:
        raise InputError(f"{path}: this is a directory; give {itself} (.toml) itself.") from None
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such {what}.") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"{path}: cannot be read: {reason}.") from None
    if len(data) > most:
        owner = one.removesuffix(" file")
        raise InputError(f"{path}: the file is larger than {most} bytes, the most {owner} may have.")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8, as {one} must be.") from None
