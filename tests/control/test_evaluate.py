import numpy as np

from robosim.control.controller import RandomController
from robosim.control.evaluate import evaluate
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv


def team(num_envs, episode_steps=300):
    return VectorEnv("paper", robots=2, num_envs=num_envs, episode_steps=episode_steps)


def test_figures_are_those_of_the_episodes_themselves():
    evaluation = evaluate(LanesController(), team(2), 2, seed=5)
    env, lanes = team(2), LanesController()
    observation = env.reset(seed=5)
    lanes.reset(env)
    env.world.meter()
    collided, closest = np.zeros(2, int), env.world.closest
    for _ in range(300):
        transition = env.step(lanes.act(env, observation))
        observation = transition.observation
        if not transition.truncated.any():
            collided += env.dec_pomdp.truth.collided.sum(axis=1)
            closest = env.world.closest.copy()
    assert evaluation.delivered == tuple(map(tuple, transition.final_delivered.tolist()))
    assert evaluation.mean > 0
    assert evaluation.closest is not None
    assert (np.array(evaluation.closest) <= closest.min(axis=1)).all()
    assert 0.05 < min(evaluation.closest) < 0.5
    # The last decision's collisions are gone once the next episode has begun.
    assert all(0 <= full - seen <= 2 for full, seen in zip(evaluation.collisions, collided, strict=True))
    assert (evaluation.controller, evaluation.arena, evaluation.robots) == ("lanes", "paper", 2)


def test_equal_seeds_give_equal_results_and_surplus_episodes_are_left_out():
    first = evaluate(RandomController(), team(2, 50), 3, seed=1)
    assert first.episodes == len(first.collisions) == 3
    assert evaluate(RandomController(), team(2, 50), 3, seed=1) == first


def test_the_environment_is_left_as_it_was_found():
    env = team(1, 20)
    evaluate(RandomController(), env, 1)
    assert env.autoreset


def test_one_robot_comes_near_to_nobody():
    env = VectorEnv("paper", robots=1, episode_steps=5)
    assert evaluate(RandomController(), env, 1).closest is None
