import itertools

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


def test_the_longest_time_without_a_delivery_has_the_ends_of_an_episode_in_it():
    def deliveries_of(episode_steps):
        """Return the decisions of each of two episodes that end with more delivered than before."""
        env, lanes = team(2, episode_steps), LanesController()
        observation = env.reset(seed=5)
        lanes.reset(env)
        decisions, before = ([], []), [0, 0]
        for step in range(episode_steps):
            transition = env.step(lanes.act(env, observation))
            observation = transition.observation
            for one, now in enumerate(transition.final_delivered.sum(axis=1)):
                if now > before[one]:
                    decisions[one].append(step + 1)
                before[one] = now
        return decisions

    for episode_steps in (20, 300):
        evaluation = evaluate(LanesController(), team(2, episode_steps), 2, seed=5)
        times = [[0, *one, episode_steps] for one in deliveries_of(episode_steps)]
        assert evaluation.longest_lapse == tuple(
            max(after - before for before, after in itertools.pairwise(one)) for one in times
        )
    assert min(map(len, times)) > 3


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
