"""A stage in the corridor, for tests of algorithms."""

import json

import numpy as np

from robosim.learning.actors import FrozenTeam
from robosim.learning.algorithms.protocol import Experience, LargeMemory, State, Task
from robosim.learning.curriculum import Stage
from robosim.learning.loop import StageLoop
from robosim.learning.metrics import MetricsLog


def task_in(env, decisions, **changes):
    """Return what the robots of `env` have to learn."""
    task = {
        "robots": env.robots,
        "num_envs": env.num_envs,
        "names": env.layout.names,
        "num_actions": env.num_actions,
        "actions": "cardinal",
        "decisions": decisions,
    }
    return Task(**(task | changes))


def loop_in(env, config, decisions, seed=0):
    """Return a stage of so many decisions in which all robots of `env` learn."""
    algorithm = config.build(task_in(env, decisions), np.random.SeedSequence(seed))
    stage = Stage("together", env.robots, env.robots, 1.0, explores=True)
    return StageLoop(stage, decisions, env, algorithm, None, MetricsLog())


def learned(env, config, decisions, seed=0):
    """Return the loop after all its decisions."""
    loop = loop_in(env, config, decisions, seed)
    while not loop.finished:
        loop.advance()
    return loop


def deliveries(corridor, algorithm, robots):
    """Return how often each robot delivers in 100 decisions without exploration, [envs, robots]."""
    test = corridor(robots=robots, num_envs=4, episode_steps=101, seed=1)
    team, observation = FrozenTeam(algorithm.actors()), test.reset()
    for _ in range(100):
        observation = test.step(team.act(observation)).observation
    return test.delivered


def made_up(seed, decisions=4, envs=3, robots=2, size=7):
    """Return experience drawn at random, [decisions, envs, ...], of which some ends or is cut off."""
    rng = np.random.default_rng(seed)
    shape = (decisions, envs, robots)
    ends = rng.choice(3, size=(decisions, envs), p=[0.6, 0.2, 0.2])
    seen = rng.random((3, *shape, size), np.float32)
    reward = rng.normal(size=shape).astype(np.float32)
    return Experience(seen[0], rng.integers(5, size=shape), reward, seen[1], seen[2], ends == 1, ends == 2)


def one_by_one(done):
    """Return the decisions of experience [decisions, envs, ...]."""
    return [Experience(*decision) for decision in zip(*done, strict=True)]


def same_bits_after_restoring(whole, rest, decisions, more, size):
    """Check that `rest`, restored from `whole` after some decisions, goes on as it does."""
    seen = one_by_one(made_up(1, decisions + more, size=size))

    def take(algorithms, decision):
        acted = [one.act(decision.observation, 0.5) for one in algorithms]
        for one in algorithms:
            np.testing.assert_array_equal(acted[0], acted[-1])
            one.update(0.5)
            one.observe(decision._replace(action=acted[0]))

    for decision in seen[:decisions]:
        take([whole], decision)
    if isinstance(whole, LargeMemory):
        first, last = whole.held()
        middle = (first + last) // 2
        parts = [whole.export(first, middle), whole.export(middle, last)] if first < last else []
    tensors, facts = whole.state()
    rest.restore(State(tensors, json.loads(json.dumps(facts))))
    if isinstance(whole, LargeMemory):
        rest.recall(first, parts)
    before = whole.actors().weights
    for decision in seen[decisions:]:
        take([whole, rest], decision)
    after, again = whole.actors().weights, rest.actors().weights
    for name, array in after.items():
        np.testing.assert_array_equal(array, again[name])
        assert not np.array_equal(array, before[name])
