"""Makes `robosim/Excavation-v0` and `robosim/ExcavationTeam-v0` known to Gymnasium, without importing it.

Gymnasium asks nobody for environments, so they must be registered; and a robot's computer, which imports
robosim too, does without Gymnasium.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_GYMNASIUM = "gymnasium"
_BATCHED = "robosim.envs.gym_vector:ExcavationVectorEnv"


def register_with_gymnasium() -> None:
    """Register the environment now if Gymnasium is imported already, or else as soon as it is."""
    if _GYMNASIUM in sys.modules:
        _register()
    else:
        sys.meta_path.insert(0, _Registration())


class _Registration(MetaPathFinder):
    """Has Gymnasium found as always, once, and registers the environment when it has been imported."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _GYMNASIUM:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                _register()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]  # of this import
        return spec


def _register() -> None:
    import gymnasium

    gymnasium.register(
        id="robosim/Excavation-v0",
        entry_point="robosim.envs.gym_env:ExcavationEnv",
        vector_entry_point=_BATCHED,
        order_enforce=False,  # the environment's own sentences say more
    )
    # Of a batch alone: what one of its rows does is no environment by itself.
    gymnasium.register(
        id="robosim/ExcavationTeam-v0",
        entry_point=None,
        vector_entry_point=_BATCHED,
        kwargs={"others": None},
    )
