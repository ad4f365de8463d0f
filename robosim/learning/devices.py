"""Names of devices on which networks learn."""

from __future__ import annotations

from robosim.errors import InputError, shown


def require_device_name(name: str) -> None:
    """Raise InputError for what is no device's name, whether this machine has it or not."""
    if name != "cpu" and name.partition(":")[0] != "cuda":
        raise InputError(f'device is {shown(name)}, but must be "cpu", or "cuda" for a GPU.')
