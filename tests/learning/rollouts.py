"""Rollouts of random numbers, for tests of algorithms."""

import numpy as np

from robosim.learning.algorithms.protocol import Experience, Task

BLOCKABLE = tuple(f"gain {goal} {side}" for goal in ("home", "source") for side in "NSWE")


def task(robots=2, names=tuple(f"number {i}" for i in range(7)), num_actions=5, decisions=100, groups=()):
    return Task(robots, 3, names, num_actions, "cardinal", decisions, groups=groups)


def build(config, seed=0, start=None, **changes):
    return config.build(task(**changes), np.random.SeedSequence(seed), start)


def rollout(seed, decisions=4, envs=3, robots=2, size=7):
    """Return an Experience of arrays [decisions, envs, ...]; two in five decisions end an episode."""
    rng = np.random.default_rng(seed)
    shape = (decisions, envs, robots)
    ends = rng.choice(3, size=(decisions, envs), p=[0.6, 0.2, 0.2])
    seen = rng.random((3, *shape, size), np.float32)
    reward = rng.normal(size=shape).astype(np.float32)
    return Experience(seen[0], rng.integers(5, size=shape), reward, seen[1], seen[2], ends == 1, ends == 2)


def one_by_one(done):
    """Return the decisions of experience [decisions, envs, ...]."""
    return [Experience(*decision) for decision in zip(*done, strict=True)]


def take_in(algorithm, done):
    for decision in one_by_one(done):
        algorithm.observe(decision)


def weights_of(algorithm):
    """Return copies of all weights, of actors and critics."""
    critic = {f"critic{i}": one.detach().numpy().copy() for i, one in enumerate(algorithm.critic.parameters)}
    return {**algorithm.actors().weights, **critic}
