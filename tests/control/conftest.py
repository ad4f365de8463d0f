import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.arena.schema import RobotSection, TimingSection
from robosim.control.card import (
    Evaluation,
    NetworkCard,
    ObservationCard,
    PolicyCard,
    TechniqueCard,
    TrainingCard,
    arena_card,
)


def make_card(robots=3, size=7, hidden=(16, 12), **changes):
    fields = {
        "robots": robots,
        "technique": TechniqueCard(name="iql", global_reward=False, stigmergy=False, curriculum=False),
        "arena": arena_card(load_arena("paper")),
        "observation": ObservationCard(
            encoding="expanded", stigmergy=True, names=tuple(f"number {i}" for i in range(size))
        ),
        "actions": "cardinal",
        "num_actions": 5,
        "network": NetworkCard(hidden=hidden),
        "robot": RobotSection(),
        "timing": TimingSection(),
        "training": TrainingCard(
            command="robosim train", seed=1, steps=10, wall_time=1.5, versions={"numpy": "2"}
        ),
        "evaluation": Evaluation(
            controller="x",
            arena="paper",
            robots=robots,
            episode_steps=100,
            seed=0,
            delivered=((1,) * robots, (3,) * robots),
            collisions=(4, 5),
        ),
    }
    return PolicyCard(**(fields | changes))


def make_weights(card, seed=0, dtype=np.float32):
    rng = np.random.default_rng(seed)
    weights = {}
    for layer, (inputs, outputs) in enumerate(card.layers):
        weights[f"layer{layer}.weight"] = rng.normal(size=(card.robots, inputs, outputs)).astype(dtype)
        weights[f"layer{layer}.bias"] = rng.normal(size=(card.robots, outputs)).astype(dtype)
    return weights


@pytest.fixture
def card():
    return make_card()


@pytest.fixture
def card_of():
    return make_card


@pytest.fixture
def weights_of():
    return make_weights
