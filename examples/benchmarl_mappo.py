"""MAPPO of BenchMARL on a batch of environments; any other of its algorithms in the same way.

pip install benchmarl "torchrl<0.12" "tensordict<0.12"   # in an environment of its own, beside robosim
python examples/benchmarl_mappo.py --frames 60000 --out runs/benchmarl
"""

import argparse
from pathlib import Path

from benchmarl.algorithms import MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

from robosim.learning.faces.benchmarl import ExcavationTask


def experiment(robots: int, frames: int, envs: int, episode_steps: int, seed: int, out: Path) -> Experiment:
    """Return an experiment of `frames` decisions, evaluated after every round of collecting and learning."""
    config = ExperimentConfig.get_from_yaml()
    config.loggers, config.save_folder = ["csv"], str(out)
    config.max_n_iters, config.max_n_frames = None, frames
    config.on_policy_n_envs_per_worker = envs
    config.on_policy_collected_frames_per_batch = envs * episode_steps
    config.on_policy_minibatch_size = min(envs * episode_steps, 1000)
    config.on_policy_n_minibatch_iters = 5
    config.evaluation_interval = config.on_policy_collected_frames_per_batch
    config.evaluation_episodes = 4
    config.render = False
    task = ExcavationTask("paper", robots=robots, reward="global", episode_steps=episode_steps)
    network = MlpConfig.get_from_yaml()
    return Experiment(task, MappoConfig.get_from_yaml(), network, seed, config, critic_model_config=network)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="MAPPO of BenchMARL for a team on arena `paper`.")
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--frames", type=int, default=60_000, help="joint decisions")
    parser.add_argument("--envs", type=int, default=16, help="environments side by side")
    parser.add_argument("--episode-steps", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarl"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    experiment(args.robots, args.frames, args.envs, args.episode_steps, args.seed, args.out).run()
