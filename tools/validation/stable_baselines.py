"""Stable-Baselines3 on simple_spread with shared parameters: each robot is an environment of its own to it.

Settings are those that its authors tuned for LunarLander-v3 (RL Baselines3 Zoo), also a short task with a few
numbers as observation and discrete actions, but for what the number of environments and the length of
episodes ask for.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import stable_baselines3
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from validation.spread import ACTIONS, ROBOTS, SIZE, Act, Spread

Options = dict[str, Any]

ENVS = 8
METHODS: dict[str, tuple[str, Options]] = {
    "dqn": (
        "DQN",
        {
            "learning_rate": 6.3e-4,
            "batch_size": 128,
            "buffer_size": 300_000,
            "learning_starts": 1000 * ROBOTS,
            "gamma": 0.95,
            "target_update_interval": 250 * ROBOTS,
            "train_freq": 1,
            "gradient_steps": ENVS,  # one for each joint decision
            "exploration_fraction": 0.12,
            "exploration_final_eps": 0.1,
            "policy_kwargs": {"net_arch": [256, 256]},
        },
    ),
    "ia2c": ("A2C", {"learning_rate": 8.3e-4, "n_steps": 5, "gamma": 0.95, "ent_coef": 1e-5}),
    "ippo": (
        "PPO",
        {
            "n_steps": 128,
            "batch_size": 64,
            "n_epochs": 4,
            "gamma": 0.95,
            "gae_lambda": 0.98,
            "ent_coef": 0.01,
        },
    ),
}


class SpreadVecEnv(VecEnv):
    """Robot r of environment e is environment `e * ROBOTS + r`."""

    def __init__(self, spread: Spread) -> None:
        box = gymnasium.spaces.Box(-np.inf, np.inf, (SIZE,), np.float32)
        super().__init__(spread.num_envs * ROBOTS, box, gymnasium.spaces.Discrete(ACTIONS))
        self._spread = spread

    def reset(self) -> NDArray[np.float32]:
        return self._spread.reset().reshape(self.num_envs, SIZE)

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self._actions = actions.reshape(-1, ROBOTS)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[Options]]:
        step = self._spread.step(self._actions)
        infos: list[Options] = [{} for _ in range(self.num_envs)]
        if step.truncated:
            final = step.final_observation.reshape(self.num_envs, SIZE)
            infos = [{"TimeLimit.truncated": True, "terminal_observation": one} for one in final]
        ended = np.full(self.num_envs, step.truncated)
        return step.observation.reshape(self.num_envs, SIZE), step.reward.ravel(), ended, infos

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def learn(method: str, seed: int, decisions: int) -> tuple[Act, list[float], Options]:
    """Return what was learned, the returns on the way, and the settings."""
    torch.set_num_threads(1)
    name, settings = METHODS[method]
    spread = Spread(ENVS, seed)
    model = getattr(stable_baselines3, name)(
        "MlpPolicy", SpreadVecEnv(spread), seed=seed, device="cpu", **settings
    )
    model.learn(decisions * ROBOTS)

    def act(observation: NDArray[np.float32], _: bool) -> NDArray[np.int64]:
        chosen, _ = model.predict(observation.reshape(-1, SIZE), deterministic=True)
        return np.asarray(chosen, np.int64).reshape(-1, ROBOTS)

    return act, spread.returns, {"num_envs": ENVS, **settings}
