"""Robot teams in confined spaces: rigid bodies, pheromones, learned policies, playback.

The names below load on first use, so that `import robosim` stays light.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from robosim.registration import register_with_gymnasium

if TYPE_CHECKING:
    from robosim.arena import arena_names, load_arena
    from robosim.control.controller import make_controller
    from robosim.control.policy import load_policy
    from robosim.envs.parallel import parallel_env
    from robosim.envs.workers import vector_env
    from robosim.errors import InputError

__version__ = "0.1.0"

__all__ = [
    "InputError",
    "__version__",
    "arena_names",
    "load_arena",
    "load_policy",
    "make_controller",
    "parallel_env",
    "vector_env",
]

_HOME_OF_NAME = {
    "InputError": "robosim.errors",
    "arena_names": "robosim.arena",
    "load_arena": "robosim.arena",
    "load_policy": "robosim.control.policy",
    "make_controller": "robosim.control.controller",
    "parallel_env": "robosim.envs.parallel",
    "vector_env": "robosim.envs.workers",
}

register_with_gymnasium()


def __getattr__(name: str) -> object:
    if name not in _HOME_OF_NAME:
        raise AttributeError(f"module 'robosim' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME_OF_NAME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
