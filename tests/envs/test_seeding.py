"""Faces with one environment draw fresh entropy when nobody seeds them, and say what they drew."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

import robosim
from robosim.envs.gym_env import ExcavationEnv
from robosim.envs.gym_vector import ExcavationVectorEnv
from robosim.envs.stable_baselines import ExcavationVecEnv
from robosim.errors import InputError


def test_copies_that_nobody_seeds_differ_and_can_be_repeated() -> None:
    batch = gymnasium.make_vec("robosim/Excavation-v0", num_envs=3, robots=2, vectorization_mode="sync")
    observations, infos = batch.reset()
    seeds = infos["seed"].tolist()
    assert len(set(seeds)) == 3
    assert len({row.tobytes() for row in observations}) == 3
    batch.close()
    again = gymnasium.make("robosim/Excavation-v0", robots=2)
    for seed, row in zip(seeds, observations, strict=True):
        observation, info = again.reset(seed=seed)
        assert info["seed"] == seed
        assert np.array_equal(observation, row)


def test_two_unseeded_teams_differ_and_say_their_seeds() -> None:
    teams = [robosim.parallel_env("paper", robots=2) for _ in range(2)]
    starts = [team.reset() for team in teams]
    seeds = [infos["robot_0"]["seed"] for _, infos in starts]
    assert seeds[0] != seeds[1]
    assert not np.array_equal(starts[0][0]["robot_0"], starts[1][0]["robot_0"])
    again, _ = robosim.parallel_env("paper", robots=2).reset(seed=seeds[0])
    assert np.array_equal(again["robot_1"], starts[0][0]["robot_1"])


def test_without_a_seed_the_next_episode_of_the_one_before_begins() -> None:
    one, other = (robosim.parallel_env("paper", robots=2) for _ in range(2))
    one.reset(seed=7)
    second, infos = one.reset()
    other.reset(seed=7)
    assert np.array_equal(second["robot_0"], other.reset()[0]["robot_0"])
    assert infos["robot_0"]["seed"] == 7


FACES = {
    ExcavationEnv: "reset(seed=...)",
    robosim.parallel_env: "reset(seed=...)",
    ExcavationVectorEnv: "reset(seed=...)",
    ExcavationVecEnv: "seed(...), or to the algorithm",
}


@pytest.mark.parametrize("face", FACES)
def test_a_seed_where_none_is_taken_is_refused_and_not_dropped(face: Callable[..., Any]) -> None:
    with pytest.raises(InputError) as refused:
        face("paper", seed=3)
    assert str(refused.value) == f"seed is not an option of this environment: give it to {FACES[face]}."
    # What a batch of its own takes besides, and a face decides.
    with pytest.raises(InputError, match='^"autoreset" is not an option: '):
        face("paper", autoreset=False)
