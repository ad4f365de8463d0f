import importlib

import numpy as np
import pytest

from robosim.arena import Zone
from robosim.control.controller import make_controller
from robosim.discretise import reward
from robosim.discretise.reward import Outcome, register_reward
from robosim.envs.vector import VectorEnv


@pytest.fixture
def example(examples, monkeypatch):
    monkeypatch.setattr(reward, "_REGISTERED", {})
    return importlib.import_module("full_tunnel")


def pay(outcome: Outcome) -> np.ndarray:
    """What the example says that it pays, robot by robot."""
    arena = outcome.setting.arena
    expected = np.zeros(outcome.reward.shape)
    for env, poses in enumerate(outcome.state.pose):
        cells = [(int(y / arena.cell_size), int(x / arena.cell_size)) for x, y, _ in poses]
        inside = [arena.zones[cell] == Zone.TUNNEL for cell in cells]
        if sum(inside) <= 0.8 * arena.tunnel_length:
            continue
        for robot, within in enumerate(inside):
            if abs(outcome.gained[env, robot]) < 0.1:
                back = min(max(-outcome.reward[env, robot], 0), 0.5)
                expected[env, robot] = -1.0 if within else back
    return expected


def test_who_stands_in_a_full_tunnel_pays_and_who_waits_outside_does_not(example):
    compared = []

    def record(outcome: Outcome) -> np.ndarray:
        compared.append((example.full(outcome), pay(outcome)))
        return compared[-1][0]

    register_reward("recorded", record)
    env = VectorEnv(
        "single-lane", robots=32, num_envs=3, seed=1, idle_cost=True, neighbours=True, extra_reward="recorded"
    )
    team = make_controller("lanes")
    observation = env.reset()
    team.reset(env)
    for _ in range(300):
        observation = env.step(team.act(env, observation)).observation
    for given, expected in compared:
        np.testing.assert_array_equal(given, expected)
    assert {float(sign) for given, _ in compared for sign in np.sign(given).flat} == {-1.0, 0.0, 1.0}
