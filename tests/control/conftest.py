import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.control.card import Evaluation, PolicyCard, TechniqueCard, TrainingCard, arena_card
from robosim.control.network import NetworkSpec
from robosim.envs.config import EnvConfig


def make_card(robots=3, size=7, env=None, network=None, **changes):
    """A card of made-up observations; `env` and `network` replace fields of those records."""
    arena = load_arena("paper")
    spec = {"inputs": size, "hidden": (16, 12), "of_robot": tuple(range(robots))} | (network or {})
    fields = {
        "technique": TechniqueCard(name="iql"),
        "env": EnvConfig(arena=arena.text, robots=robots).with_options(**(env or {})),
        "arena": arena_card(arena),
        "observation": tuple(f"number {i}" for i in range(size)),
        "network": NetworkSpec(**spec),
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


def make_weights(card, seed=0):
    rng = np.random.default_rng(seed)
    return {
        name: rng.normal(size=shape).astype(card.network.precision)
        for name, shape in card.network.shapes.items()
    }


@pytest.fixture
def card():
    return make_card()


@pytest.fixture
def card_of():
    return make_card


@pytest.fixture
def weights_of():
    return make_weights
