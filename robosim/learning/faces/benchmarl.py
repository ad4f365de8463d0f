"""The BenchMARL task: teams of excavating robots for every algorithm of BenchMARL.

BenchMARL 1.5 needs torchrl below 0.12; `robosim.learning.faces.torchrl` runs on that as on newer ones.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from benchmarl.environments.common import TaskClass
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase

from robosim.arena.model import Arena
from robosim.envs.config import EnvConfig, env_config
from robosim.learning.faces.torchrl import GROUP, ExcavationTorchEnv


class ExcavationTask(TaskClass):  # type: ignore[misc]  # benchmarl ships no types
    """A team in an arena, for BenchMARL's `Experiment(task=ExcavationTask("paper", robots=4), ...)`.

    `arena` and `fields` are those of `robosim.envs.config.env_config`. Environments run as one batch. Beside
    what BenchMARL logs, it logs `collection/delivered`, the pellets that a team brings home in an episode.
    InputError for wrong fields.
    """

    def __init__(self, arena: EnvConfig | Arena | str | Path | None = None, **fields: Any) -> None:
        self._env_config, found = env_config(arena, **fields)
        name = f"{found.name}-{self._env_config.robots}"
        super().__init__(name=name, config=self._env_config.model_dump(mode="json"))

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: torch.device | str
    ) -> Callable[[], EnvBase]:
        def made() -> EnvBase:
            env = ExcavationTorchEnv(self._env_config, num_envs=num_envs, device=device)
            if seed is not None:
                env.set_seed(seed)
            return env

        return made

    def supports_continuous_actions(self) -> bool:
        return False

    def supports_discrete_actions(self) -> bool:
        return True

    def max_steps(self, env: EnvBase) -> int:
        return int(env.episode_steps)

    def has_render(self, env: EnvBase) -> bool:
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return dict(env.group_map)

    def observation_spec(self, env: EnvBase) -> Composite:
        return _without(env, "info")

    def info_spec(self, env: EnvBase) -> Composite:
        return _without(env, "observation")

    def state_spec(self, env: EnvBase) -> None:
        """Return None: central critics see the observations of all robots."""

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> None:
        """Return None: every action may be taken at any time."""

    @staticmethod
    def env_name() -> str:
        return "robosim"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        ended = batch.get(("next", "done")).squeeze(-1)
        if not bool(ended.any()):
            return {}
        delivered = batch.get(("next", GROUP, "info", "delivered"))[ended]
        return {"collection/delivered": float(delivered.sum(dim=(-2, -1)).float().mean())}


def _without(env: EnvBase, name: str) -> Composite:
    """Return the spec of what one environment shows of its robots, all but `name`."""
    spec = env.full_observation_spec_unbatched.clone()
    del spec[GROUP, name]
    return spec
