import numpy as np
import pytest

from robosim.arena.schema import RobotSection, TimingSection
from robosim.control.card import ObservationCard, PheromoneCard, arena_card
from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import Policy
from robosim.discretise.pheromone import PheromoneConfig
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError


@pytest.fixture
def fitting(card_of):
    """A card that fits two robots in the paper's arena."""
    env = VectorEnv("paper", robots=2)
    names = tuple(env.layout.names)

    def make(**changes):
        observation = ObservationCard(encoding="expanded", stigmergy=True, names=names)
        fields = {"robots": 2, "observation": observation, "evaluation": None}
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
    ("options", "told"),
    [
        ({"robots": 3}, "robots was 2 in training and is 3 here."),
        ({"actions": "wheels"}, "actions was cardinal in training and is wheels here."),
        ({"stigmergy": False}, "stigmergy was True in training and is False here."),
        ({"encoding": "paper"}, "observation encoding was expanded in training and is paper here."),
    ],
)
def test_another_environment_is_refused_in_one_sentence(fitting, weights_of, options, told):
    env = VectorEnv("paper", **({"robots": 2} | options))
    with pytest.raises(InputError) as caught:
        controller(fitting(), weights_of).reset(env)
    assert str(caught.value) == f"policy mine does not fit arena 'paper': {told}"


def test_another_body_floor_or_clock_is_refused(fitting, weights_of):
    env = VectorEnv("paper", robots=2)
    cell = arena_card(env.arena).model_copy(update={"cell_size": 0.2})
    for changes, told in (
        ({"robot": RobotSection(mass=0.5)}, "robot mass was 0.5 in training and is 0.4 here."),
        ({"arena": cell}, "cell size (m) was 0.2 in training and is 0.15 here."),
        (
            {"timing": TimingSection(decision_period=1.2)},
            f"decision period (s) was 1.2 in training and is {env.arena.timing.decision_period} here.",
        ),
    ):
        with pytest.raises(InputError, match="does not fit") as caught:
            controller(fitting(**changes), weights_of).reset(env)
        assert str(caught.value).endswith(told)


def test_observations_that_mean_something_else_are_refused(fitting, weights_of):
    env = VectorEnv("paper", robots=2)
    names = list(env.layout.names)
    names[3] = "luck"
    other = ObservationCard(encoding="expanded", stigmergy=True, names=tuple(names))
    with pytest.raises(InputError) as caught:
        controller(fitting(observation=other), weights_of).reset(env)
    assert str(caught.value).endswith(
        f": observation entry 3 was luck in training and is {env.layout.names[3]} here."
    )
    fewer = ObservationCard(encoding="expanded", stigmergy=True, names=tuple(env.layout.names[:-1]))
    with pytest.raises(InputError) as caught:
        controller(fitting(observation=fewer), weights_of).reset(env)
    size = env.layout.size
    assert str(caught.value).endswith(f": observation size was {size - 1} in training and is {size} here.")


def test_size_is_that_of_the_names():
    layout = VectorEnv("paper", robots=2).layout
    assert np.shape(layout.low) == (layout.size,) == (len(layout.names),)


def test_other_pheromones_are_refused_and_the_policys_own_are_given(fitting, weights_of):
    env = VectorEnv("paper", robots=2)
    other = ObservationCard(
        encoding="expanded", stigmergy=True, names=env.layout.names, pheromone=PheromoneCard(decay=0.2)
    )
    driver = controller(fitting(observation=other), weights_of)
    with pytest.raises(InputError) as caught:
        driver.reset(env)
    assert str(caught.value).endswith(": pheromone decay was 0.2 in training and is 0.1 here.")
    own = environment_for(driver)
    assert own.config.pheromone == PheromoneConfig(decay=0.2)
    driver.reset(own)
