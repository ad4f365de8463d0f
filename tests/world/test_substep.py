"""Half the substep changes what is delivered by less than three per cent."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv

DECISIONS, ENVS = 1500, 8


@pytest.mark.slow
def test_half_the_substep_delivers_as_much_within_three_per_cent() -> None:
    """Eight robots by lanes on the paper's arena; the standard error of the difference is well below."""
    arena = load_arena("paper")
    means, errors = [], []
    for substeps in (12, 24):
        finer = replace(arena, timing=replace(arena.timing, substeps=substeps))
        env = VectorEnv(finer, robots=8, num_envs=ENVS, seed=3, episode_steps=DECISIONS, autoreset=False)
        controller = LanesController()
        observation = env.reset()
        controller.reset(env)
        for _ in range(DECISIONS):
            observation = env.step(controller.act(env, observation)).observation
        delivered = env.delivered.sum(axis=1)
        means.append(float(delivered.mean()))
        errors.append(float(delivered.std(ddof=1) / np.sqrt(ENVS)))
    change = means[1] / means[0] - 1.0
    error = math.hypot(*errors) / means[0]
    print(f"12 substeps: {means[0]:.2f} +- {errors[0]:.2f}, 24: {means[1]:.2f} +- {errors[1]:.2f}; "
          f"change {change:+.2%} +- {error:.2%}")  # fmt: skip
    assert abs(change) < 0.03
    assert error < 0.0125
    assert arena.timing.substeps == 12
