"""Independent Q-learning by TorchRL, on robosim's PettingZoo face.

pip install "torchrl>=0.14.1,<0.15"
python examples/torchrl_iql.py --frames 20000 --out runs/torchrl
robosim evaluate runs/torchrl
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from saving import save_team
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import PettingZooWrapper, RewardScaling, TransformedEnv
from torchrl.modules import EGreedyModule, MultiAgentMLP, QValueModule
from torchrl.objectives import DQNLoss, HardUpdate

import robosim

# TorchRL puts robot_0, robot_1 ... into the group "robot"; under it lie tensors [..., robots, ...].
OBSERVATION, ACTION, REWARD = ("robot", "observation"), ("robot", "action"), ("robot", "reward")
VALUE, CHOSEN = ("robot", "action_value"), ("robot", "chosen_action_value")
DONE, TERMINATED = ("robot", "done"), ("robot", "terminated")
ROUND = 50
"""Decisions between two rounds of updates, and updates in a round."""


def learn(arena: str, robots: int, frames: int, seed: int) -> MultiAgentMLP:
    """Let a team act and learn for `frames` decisions; returns its networks, one for each robot."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # networks this small gain nothing from more
    env = PettingZooWrapper(robosim.parallel_env(arena, robots=robots, reward="local", episode_steps=1250))
    env.set_seed(seed)
    env = TransformedEnv(env, RewardScaling(loc=0.0, scale=0.1, in_keys=[REWARD]))
    networks = MultiAgentMLP(
        n_agent_inputs=env.observation_spec[OBSERVATION].shape[-1],
        n_agent_outputs=env.full_action_spec[ACTION].space.n,
        n_agents=robots,
        centralized=False,  # each of its own observation
        share_params=False,  # and by its own weights
        num_cells=(128, 128),
        activation_class=torch.nn.ReLU,
    )
    policy = TensorDictSequential(
        TensorDictModule(networks, in_keys=[OBSERVATION], out_keys=[VALUE]),
        QValueModule("categorical", action_value_key=VALUE, out_keys=[ACTION, VALUE, CHOSEN]),
    )
    explore = EGreedyModule(
        env.full_action_spec[ACTION],
        eps_end=0.02,
        annealing_num_steps=max(1, frames // 5),
        action_key=ACTION,
    )
    loss = DQNLoss(policy, action_space="categorical", double_dqn=True)
    loss.set_keys(
        action=ACTION, action_value=VALUE, value=CHOSEN, reward=REWARD, done=DONE, terminated=TERMINATED
    )
    loss.make_value_estimator(gamma=0.95)
    target = HardUpdate(loss, value_network_update_interval=100)
    adam = torch.optim.Adam(loss.parameters(), lr=1e-3)
    replay = TensorDictReplayBuffer(storage=LazyTensorStorage(frames), batch_size=64)
    collector = Collector(
        env,
        TensorDictSequential(policy, explore),
        frames_per_batch=ROUND,
        total_frames=frames,
        auto_register_policy_transforms=False,
    )
    for number, decisions in enumerate(collector, start=1):
        replay.extend(decisions)
        explore.step(ROUND)
        for _ in range(ROUND):
            error = loss(replay.sample())["loss"]
            adam.zero_grad()
            error.backward()
            adam.step()
            target.step()
        if number * ROUND % 200 == 0:
            delivered = decisions["next", "robot", "info", "delivered"][-1].sum()
            print(f"frame {number * ROUND}: loss {error.item():.4f}, {delivered:.0f} pellets this episode")
    collector.shutdown()
    return networks


def weights_of(networks: MultiAgentMLP) -> dict[str, NDArray[np.float32]]:
    """Return the weights as policy folders name and shape them; torch has [robots, out, in]."""
    layers = [networks.params[index].detach() for index in sorted(networks.params.keys(), key=int)]
    weights = {f"layer{i}.weight": layer["weight"].transpose(1, 2).numpy() for i, layer in enumerate(layers)}
    return weights | {f"layer{i}.bias": layer["bias"].numpy() for i, layer in enumerate(layers)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Independent Q-learning by TorchRL on robosim.parallel_env.")
    parser.add_argument("--frames", type=int, default=20_000, help="decisions of the team")
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--arena", default="paper")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="policy folder to write")
    options = parser.parse_args()
    if options.frames < ROUND or options.frames % ROUND:
        parser.error(f"--frames is {options.frames}: it must be a multiple of {ROUND}.")
    start = time.perf_counter()
    team = weights_of(learn(options.arena, options.robots, options.frames, options.seed))
    if options.out:
        env = robosim.vector_env(options.arena, robots=options.robots)
        took = time.perf_counter() - start
        save_team(
            options.out,
            team,
            env,
            "iql",
            seed=options.seed,
            steps=options.frames,
            wall_time=took,
        )
