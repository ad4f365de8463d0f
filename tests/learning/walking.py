"""A stage in the corridor, for tests of algorithms."""

import numpy as np

from robosim.learning.actors import FrozenTeam
from robosim.learning.algorithms.protocol import Task
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
