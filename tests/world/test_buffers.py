"""Spaces read and command through buffers whose memory outlives them, since pymunk never gives it back."""

import gc

import numpy as np

from robosim.envs.vector import VectorEnv
from robosim.world.physics import buffers


def test_buffers_are_used_again_by_the_episodes_that_follow() -> None:
    gc.collect()
    held = len(buffers._SPARE)
    for _ in range(5):
        env = VectorEnv("single-lane", robots=2, num_envs=2)
        env.reset()
        env.step(np.zeros((2, 2), np.int64))
        env.reset()
        del env
        gc.collect()
    # Two environments, of which old and new episode stood side by side for a moment.
    assert len(buffers._SPARE) <= max(held, 4)


def test_a_space_that_still_lives_keeps_its_buffers_to_itself() -> None:
    envs = [VectorEnv("single-lane", robots=2, seed=seed) for seed in (0, 1)]
    alone = VectorEnv("single-lane", robots=2, seed=1)
    for env in (*envs, alone):
        env.reset()
    for _ in range(20):
        for env in (*envs, alone):
            env.step([[0, 2]])
    assert np.array_equal(envs[1].world.state.pose, alone.world.state.pose)
    assert not np.array_equal(envs[0].world.state.pose, alone.world.state.pose)
