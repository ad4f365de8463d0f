"""How torch computes: on which device, with how many threads, and what becomes of denormals."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from robosim.errors import InputError, shown
from robosim.learning.devices import require_device_name


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch compute with one thread until the end of the block.

    Networks this small gain nothing from more, and results must not depend on how many cores there are.
    The number of threads belongs to the process, so it goes back to what it was.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def denormals_flushed() -> Iterator[None]:
    """Count denormals as zero: moments of unused weights decay into them, and updates cost a third more.

    It is a setting of the processor, so it goes back before anybody else computes.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def find_device(name: str) -> torch.device:
    """Return the torch device of that name; InputError when it is not "cpu" or a GPU that is there."""
    require_device_name(name)
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(
            f'device is {shown(name)}, but must be "cpu": torch finds no such GPU on this machine.'
        ) from error
    return device


def gpu_name(name: str) -> str:
    """Return what the GPU of that name calls itself, or the name where it is not there, as after a move.

    "" for the processor.
    """
    if name == "cpu":
        return ""
    try:
        return torch.cuda.get_device_name(find_device(name))
    except InputError:
        return name
