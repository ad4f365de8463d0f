"""Rollouts of random numbers, for tests of algorithms that learn from what their present policy did."""

import json

import numpy as np

from robosim.learning.algorithms.protocol import Experience, State, Task

BLOCKABLE = tuple(f"gain {goal} {side}" for goal in ("home", "source") for side in "NSWE")


def task(robots=2, names=tuple(f"number {i}" for i in range(7))):
    return Task(robots, num_envs=3, names=names, num_actions=5, actions="cardinal", decisions=100)


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


def take_in(algorithm, done):
    for decision in zip(*done, strict=True):
        algorithm.observe(Experience(*decision))


def weights_of(algorithm):
    """Return copies of all weights, of actors and critics."""
    critic = {f"critic{i}": one.detach().numpy().copy() for i, one in enumerate(algorithm.critic.parameters)}
    return {**algorithm.actors().weights, **critic}


def check_that_a_restored_one_goes_on_in_the_same_bits(config, decisions):
    """One that restores what another saved after so many decisions acts and learns as that one does."""
    whole, rest = (build(config, seed) for seed in (0, 7))
    seen = rollout(1, decisions=decisions + 9)

    def take(algorithms, step):
        acted = [one.act(seen.observation[step], 0.5) for one in algorithms]
        for one in algorithms:
            np.testing.assert_array_equal(acted[0], acted[-1])
            one.update(0.5)
            one.observe(Experience(*(part[step] for part in seen))._replace(action=acted[0]))

    for step in range(decisions):
        take([whole], step)
    tensors, facts = whole.state()
    rest.restore(State(tensors, json.loads(json.dumps(facts))))
    before = whole.actors().weights
    for step in range(decisions, decisions + 9):
        take([whole, rest], step)
    after, again = weights_of(whole), weights_of(rest)
    for name, array in after.items():
        np.testing.assert_array_equal(array, again[name])
        assert name not in before or not np.array_equal(array, before[name])
