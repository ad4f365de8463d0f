"""robosim's algorithms on simple_spread, with their defaults but for what is named here."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robosim.control.network import Networks
from robosim.learning.algorithms.protocol import Experience, Task
from robosim.learning.algorithms.registry import find_algorithm
from robosim.learning.computing import one_thread
from validation.spread import ACTIONS, ROBOTS, SIZE, Act, Spread

Options = dict[str, Any]

METHODS: dict[str, tuple[str, int, Options]] = {
    "dqn": ("dqn", 8, {"parameters": "shared"}),
    "ia2c": ("ia2c", 8, {"parameters": "shared"}),
    "maa2c": ("maa2c", 8, {}),
    "ippo": ("ppo", 32, {"parameters": "shared"}),
    "mappo": ("ppo", 32, {"parameters": "shared", "critic": "team"}),
    "maddpg": ("maddpg", 8, {}),
    "madqn": ("madqn", 8, {}),
    "pqn": ("pqn", 32, {"parameters": "shared"}),
    "vdn": ("qmix", 8, {"mixer": "sum"}),
    "qmix": ("qmix", 8, {}),
    # With what stable_baselines.py gives to its own, as far as both have it.
    "dqn-alike": (
        "dqn",
        8,
        {
            "parameters": "shared",
            "hidden": (256, 256),
            "learning_rate": 6.3e-4,
            "learning_rate_end": 1.0,
            "return_steps": 1,
            "reward_scale": 1.0,
            # Of moments, each with the transitions of three robots.
            "batch_size": 43,
            "replay_capacity": 300_000,
            "updates_per_step": 1.0,
            "target_interval": 250,
            "exploration": 0.12,
            "epsilon_end": 0.1,
            "epsilon_spread": 0.0,
        },
    ),
}
"""Name of the algorithm, environments side by side, and options that differ from its defaults."""


def learn(method: str, seed: int, decisions: int) -> tuple[Act, list[float], Options]:
    """Return what was learned, the returns on the way, and the settings."""
    name, num_envs, options = METHODS[method]
    config = find_algorithm(name)(**options)
    task = Task(
        ROBOTS,
        num_envs,
        names=tuple(f"number {i}" for i in range(SIZE)),
        num_actions=ACTIONS,
        actions="cardinal",
        decisions=decisions,
    )
    algorithm = config.build(task, np.random.SeedSequence(seed))
    env = Spread(num_envs, seed)
    observation = env.reset()
    never = np.zeros(num_envs, np.bool_)
    with one_thread():
        for done in range(0, decisions, num_envs):
            progress = done / decisions
            actions = algorithm.act(observation, progress)
            algorithm.update(progress)
            step = env.step(actions)
            algorithm.observe(
                Experience(
                    observation,
                    actions,
                    step.reward,
                    step.final_observation,
                    step.observation,
                    never,
                    np.full(num_envs, step.truncated),
                )
            )
            observation = step.observation
    networks = Networks(*algorithm.actors())

    def act(observation: NDArray[np.float32], _: bool) -> NDArray[np.int64]:
        return networks.act(observation)

    return act, env.returns, {"num_envs": num_envs, **config.model_dump(mode="json")}
