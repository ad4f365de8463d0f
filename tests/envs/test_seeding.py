"""Faces with one environment draw fresh entropy when nobody seeds them, and say what they drew."""

import gymnasium
import numpy as np

import robosim


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
