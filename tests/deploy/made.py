"""Policies with made-up weights, for heads that no shipped policy has."""

from functools import cache

import numpy as np

from robosim.control.card import TrainingCard, card_for
from robosim.control.network import NetworkSpec
from robosim.control.policy import save_policy
from robosim.envs.vector import VectorEnv

TRAINING = TrainingCard(command="made up", seed=0, steps=0, wall_time=0.0, versions={})


@cache
def paper(robots, env):
    """An environment to take names and sizes from; it is never begun."""
    return VectorEnv("paper", robots=robots, **dict(env))


def random_weights(spec, seed=0):
    """Weights of a size that keeps numbers about as large from layer to layer."""
    rng = np.random.default_rng(seed)
    return {
        name: (rng.normal(size=shape) / (shape[1] ** 0.5 if len(shape) == 3 else 4)).astype(spec.precision)
        for name, shape in spec.shapes.items()
    }


def make_policy(folder, robots=3, weights=None, env=None, seed=0, **network):
    """Write a policy folder for the arena `paper`; `env` and `network` are fields of its records."""
    env = paper(robots, tuple((env or {}).items()))
    team = network.get("input") == "team"
    spec = NetworkSpec(
        inputs=env.layout.size * (robots if team else 1), hidden=(24, 16), actions=env.num_actions, **network
    )
    arrays = random_weights(spec, seed) if weights is None else weights(spec)
    save_policy(folder, arrays, card_for(env, spec, arrays, "made up", TRAINING))
    return folder


def random_observations(policy, count, seed=0):
    """Numbers within -1 to 1, [count, robots, size], with many moves blocked."""
    rng = np.random.default_rng(seed)
    shape = (count, policy.robots, len(policy.card.observation))
    observation = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
    gains = [place for place, name in enumerate(policy.card.observation) if name.startswith("gain")]
    lost = rng.random((*shape[:2], len(gains))) < 0.7
    observation[..., gains] = np.where(lost, np.float32(-1.0), observation[..., gains])
    return observation
