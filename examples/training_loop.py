"""Two robots learn to excavate: independent Double DQN, written out from robosim's public pieces.

python examples/training_loop.py --steps 30000
"""

import argparse

import numpy as np

import robosim
from robosim.envs.vector import VectorEnv
from robosim.learning.algorithms.dqn.learner import DqnSettings, StackedDoubleDQN
from robosim.learning.algorithms.dqn.returns import MultiStepReturns
from robosim.learning.algorithms.protocol import Experience
from robosim.learning.computing import one_thread
from robosim.learning.networks import NetworkShape

DISCOUNT, RETURN_STEPS = 0.95, 3


@one_thread()  # networks this small gain nothing from more
def learn(env: VectorEnv, steps: int, seed: int) -> StackedDoubleDQN:
    """Let the robots of `env` act and learn for `steps` joint decisions, summed over environments."""
    shape = NetworkShape(env.robots, env.layout.size, (128, 128, 128), env.num_actions)
    settings = DqnSettings(DISCOUNT**RETURN_STEPS, 64, 100, replay_capacity=steps, reward_scale=0.1)
    learner = StackedDoubleDQN(shape, settings, np.random.SeedSequence(seed))
    returns = MultiStepReturns(RETURN_STEPS, DISCOUNT)
    spread = np.linspace(1.0, 8.0, env.num_envs)[:, None]  # the last environments explore hardly at all
    observation = env.reset(seed)
    for step in range(0, steps, env.num_envs):
        progress = step / steps
        actions = learner.act(observation, max(0.02, 1.0 - 10.0 * progress) ** spread)
        outcome = env.step(actions)
        # An action's outcome is final_observation: observation may already be of the next episode.
        came = outcome.reward, outcome.final_observation, outcome.observation
        decision = Experience(observation, actions, *came, outcome.terminated, outcome.truncated)
        if (experience := returns.add(decision)) is not None:
            learner.replay.add(*experience)
        observation = outcome.observation
        for _ in range(env.num_envs if learner.replay.length > steps // 30 else 0):
            learner.update(learning_rate=1e-3 * (1.0 - 0.98 * progress))
    return learner


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Independent Double DQN for two robots on arena `paper`.")
    parser.add_argument("--steps", type=int, default=30_000, help="joint decisions of training")
    parser.add_argument("--test-steps", type=int, default=5000, help="decisions of each test episode")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    env = robosim.vector_env("paper", robots=2, num_envs=8, reward="local", episode_steps=1250)
    learner = learn(env, args.steps, args.seed)
    test = robosim.vector_env("paper", robots=2, num_envs=6, seed=7, episode_steps=args.test_steps)
    observation = test.reset()
    for _ in range(args.test_steps):
        outcome = test.step(learner.act(observation, epsilon=0.0))
        observation = outcome.observation
    for episode, robots in enumerate(outcome.final_delivered):
        print(f"episode {episode}: {robots.sum()} pellets, by each robot {robots.tolist()}")
