"""Policies with made-up weights, for the tools that make one out of others."""

import numpy as np

from robosim.control.card import TrainingCard, card_for
from robosim.control.network import NetworkSpec
from robosim.control.policy import save_policy
from robosim.envs.vector import VectorEnv


def make_policy(folder, seed, hidden=(8,), technique="ps-ippo", **drawing):
    """Write a policy folder for two robots that share a network with weights drawn from `seed`."""
    env = VectorEnv("paper", robots=2)
    network = NetworkSpec(inputs=env.layout.size, hidden=hidden, of_robot=(0, 0), **drawing)
    rng = np.random.default_rng(seed)
    weights = {name: rng.normal(size=shape).astype(np.float32) for name, shape in network.shapes.items()}
    training = TrainingCard(command="robosim train", seed=seed, steps=10 + seed, wall_time=1.5, versions={})
    save_policy(folder, weights, card_for(env, network, weights, technique, training))
    return folder
