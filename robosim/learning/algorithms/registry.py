"""Algorithms by name."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from robosim.errors import InputError, nearest_names, shown

if TYPE_CHECKING:
    from robosim.learning.algorithms.protocol import AlgorithmConfig

_SHIPPED = {
    "dqn": "robosim.learning.algorithms.dqn.config:DqnConfig",
    "ia2c": "robosim.learning.algorithms.ia2c:Ia2cConfig",
    "maa2c": "robosim.learning.algorithms.maa2c:MaA2cConfig",
    "ppo": "robosim.learning.algorithms.ppo:PpoConfig",
    "madqn": "robosim.learning.algorithms.madqn:MadqnConfig",
    "pqn": "robosim.learning.algorithms.pqn:PqnConfig",
    "qmix": "robosim.learning.algorithms.qmix.config:QmixConfig",
    "maddpg": "robosim.learning.algorithms.maddpg:MaddpgConfig",
}
"""Module and class of each configuration; loaded when asked for, since it may bring torch."""
_REGISTERED: dict[str, type[AlgorithmConfig]] = {}


def register_algorithm(config: type[AlgorithmConfig]) -> type[AlgorithmConfig]:
    """Make an algorithm known by the default `name` of its configuration; serves as a decorator."""
    _REGISTERED[str(config.model_fields["name"].default)] = config
    return config


def algorithm_names() -> list[str]:
    """Return the names of all algorithms, sorted."""
    return sorted({*_SHIPPED, *_REGISTERED})


def find_algorithm(name: str) -> type[AlgorithmConfig]:
    """Return the configuration of an algorithm; InputError when there is none of that name."""
    if name not in _REGISTERED:
        if name not in _SHIPPED:
            raise InputError(f"unknown algorithm {shown(name)}: {nearest_names(name, algorithm_names())}")
        module, _, attribute = _SHIPPED[name].partition(":")
        _REGISTERED[name] = getattr(importlib.import_module(module), attribute)
    return _REGISTERED[name]
