"""Keep a team that you trained by yourself as a policy folder, for robosim evaluate, play and load_policy."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import robosim
from robosim.control.card import TrainingCard, card_for
from robosim.control.network import NetworkSpec
from robosim.control.policy import save_policy
from robosim.envs.vector import VectorEnv


def save_team(
    folder: Path,
    weights: Mapping[str, NDArray[np.float32]],
    env: VectorEnv,
    technique: str,
    *,
    seed: int,
    steps: int,
    wall_time: float,
) -> None:
    """Write the policy folder of a team that learned in `env` for `steps` joint decisions and `wall_time` s.

    `weights` are `layer0.weight` [networks, in, out], `layer0.bias` [networks, out] and so on: a network for
    each robot, or one for all. ReLU follows every layer but the last, and a robot takes the action whose
    output is largest. `technique` is a name for the reader. InputError if the shapes don't fit, or if
    `folder` holds anything but a policy.
    """
    biases = [weights[name] for name in sorted(weights) if name.endswith(".bias")]
    networks = len(biases[0])
    spec = NetworkSpec(
        inputs=env.layout.size,
        hidden=tuple(bias.shape[1] for bias in biases[:-1]),
        actions=biases[-1].shape[1],
        of_robot=tuple(range(networks)) if networks > 1 else (0,) * env.robots,
    )
    training = TrainingCard(
        command=shlex.join(sys.argv)[:2000],
        seed=seed,
        steps=steps,
        wall_time=wall_time,
        versions={"robosim": robosim.__version__, "torch": version("torch"), "numpy": version("numpy")},
    )
    save_policy(folder, weights, card_for(env, spec, weights, technique, training))
