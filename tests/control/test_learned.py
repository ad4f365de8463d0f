import numpy as np
import pytest

from robosim.arena import load_arena, parse_arena
from robosim.arena.schema import RobotSection, TimingSection
from robosim.control.card import arena_card
from robosim.control.controller import make_controller
from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import Policy
from robosim.discretise.pheromone import PheromoneConfig
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError


@pytest.fixture
def fitting(card_of):
    """A card that fits two robots in the paper's arena."""
    layout = VectorEnv("paper", robots=2).layout

    def make(**changes):
        fields = {"robots": 2, "size": layout.size, "observation": layout.names, "evaluation": None}
        return card_of(**(fields | changes))

    return make


def controller(card, weights_of):
    return LearnedController(Policy(weights_of(card), card), "mine")


def test_a_fitting_policy_drives(fitting, weights_of):
    env = VectorEnv("paper", robots=2, num_envs=3)
    driver = controller(fitting(), weights_of)
    observation = env.reset()
    driver.reset(env)
    actions = driver.act(env, observation)
    assert actions.shape == (3, 2)
    assert (actions == driver.policy.act(observation)).all()
    env.step(actions)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"robots": 3}, "robots was 2 in training and is 3 here."),
        ({"actions": "wheels"}, "actions was cardinal in training and is wheels here."),
        ({"stigmergy": False}, "stigmergy was True in training and is False here."),
        ({"encoding": "paper"}, "observation encoding was expanded in training and is paper here."),
    ],
)
def test_another_environment_is_refused_in_one_sentence(fitting, weights_of, options, reason):
    env = VectorEnv("paper", **({"robots": 2} | options))
    with pytest.raises(InputError) as caught:
        controller(fitting(), weights_of).reset(env)
    assert str(caught.value) == f"policy mine does not fit arena 'paper': {reason}"


def test_another_body_cell_or_clock_is_refused(fitting, weights_of):
    env = VectorEnv("paper", robots=2)
    arena = arena_card(env.arena)
    period = env.arena.timing.decision_period
    for changes, reason in (
        ({"robot": RobotSection(mass=0.5)}, "robot mass was 0.5 in training and is 0.4 here"),
        ({"cell_size": 0.2}, "cell size (m) was 0.2 in training and is 0.15 here"),
        (
            {"timing": TimingSection(decision_period=1.2)},
            f"decision period (s) was 1.2 in training and is {period} here",
        ),
    ):
        with pytest.raises(InputError, match="does not fit") as caught:
            controller(fitting(arena=arena.changed(**changes)), weights_of).reset(env)
        assert str(caught.value).endswith(
            f"{reason}; to train a team for what is here, go on from it by --start-from."
        )


def test_another_world_may_keep_another_time_but_not_another_body(fitting, weights_of):
    env = VectorEnv("paper", robots=2)
    arena = arena_card(env.arena).changed(timing=TimingSection(decision_period=1.2))
    controller(fitting(arena=arena, env={"world": "grid"}), weights_of).reset(env)
    other = arena.changed(robot=RobotSection(mass=0.5))
    with pytest.raises(InputError, match="robot mass was 0.5 in training and is 0.4 here"):
        controller(fitting(arena=other, env={"world": "grid"}), weights_of).reset(env)


def test_observations_that_mean_something_else_are_refused(fitting, weights_of):
    env = VectorEnv("paper", robots=2)
    names = list(env.layout.names)
    names[3] = "luck"
    with pytest.raises(InputError) as caught:
        controller(fitting(observation=names), weights_of).reset(env)
    assert str(caught.value).endswith(
        f': observation entry 3 was "luck" in training and is "{env.layout.names[3]}" here.'
    )
    names[3] = "\x1b[2Jluck" + "!" * 1000
    with pytest.raises(InputError) as caught:
        controller(fitting(observation=names), weights_of).reset(env)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 300
    size = env.layout.size
    with pytest.raises(InputError) as caught:
        controller(fitting(observation=env.layout.names[:-1], size=size - 1), weights_of).reset(env)
    assert str(caught.value).endswith(f": observation size was {size - 1} in training and is {size} here.")


def test_size_is_that_of_the_names():
    layout = VectorEnv("paper", robots=2).layout
    assert np.shape(layout.low) == (layout.size,) == (len(layout.names),)


def test_other_pheromones_are_refused_and_the_policys_own_are_given(fitting, weights_of):
    driver = controller(fitting(env={"pheromone_decay": 0.2}), weights_of)
    with pytest.raises(InputError) as caught:
        driver.reset(VectorEnv("paper", robots=2))
    assert str(caught.value).endswith(": pheromone decay was 0.2 in training and is 0.1 here.")
    own = environment_for(driver)
    assert own.config.pheromone == PheromoneConfig(decay=0.2)
    driver.reset(own)
    blind = controller(fitting(env={"pheromone_decay": 0.2, "stigmergy": False}), weights_of)
    with pytest.raises(InputError) as caught:
        blind.reset(VectorEnv("paper", robots=2, stigmergy=False))
    assert "pheromone decay" not in str(caught.value)


def test_the_environment_is_that_of_the_card_but_for_what_makes_training_easier(fitting, weights_of):
    learned = {"reward": "local", "signed_distance": True, "pellet_gradient": 8.0, "episode_steps": 70}
    driver = controller(fitting(env=learned), weights_of)
    card = driver.policy.card
    env = environment_for(driver, num_envs=2, seed=3)
    assert env.config == card.env.with_options(pellet_gradient=0.0, episode_steps=0)
    assert env.episode_steps == load_arena("paper").timing.episode_steps
    changed = environment_for(driver, "s-bend", 3, episode_steps=20)
    assert (changed.arena.name, changed.robots, changed.episode_steps) == ("s-bend", 3, 20)
    assert changed.config.reward == card.env.reward


def test_a_policy_of_an_own_arena_takes_it_along(fitting, weights_of):
    text = load_arena("paper").text.replace('name = "paper"', 'name = "mine"')
    arena = parse_arena(text, "mine")
    driver = controller(fitting(env={"arena": text}, arena=arena_card(arena)), weights_of)
    env = environment_for(driver)
    assert env.arena.name == "mine"
    driver.reset(env)


def test_scripted_controllers_get_the_plain_environment():
    env = environment_for(make_controller("lanes"))
    assert env.config == VectorEnv().config
    with pytest.raises(InputError, match='world is "water", but must be "physics" or "grid"'):
        environment_for(make_controller("lanes"), world="water")
