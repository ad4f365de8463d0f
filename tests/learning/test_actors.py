import numpy as np
import pytest

from robosim.control.network import Networks, NetworkSpec
from robosim.errors import InputError
from robosim.learning.actors import FrozenTeam, expanded, joined, robots_of
from robosim.learning.algorithms.protocol import Actors


def team(of_robot, seed=0, **fields):
    spec = NetworkSpec(inputs=3, hidden=(4,), of_robot=of_robot, **fields)
    rng = np.random.default_rng(seed)
    return Actors(
        spec, {name: rng.normal(size=shape).astype(np.float32) for name, shape in spec.shapes.items()}
    )


OBSERVATION = np.random.default_rng(5).normal(size=(20, 4, 3)).astype(np.float32)


def outputs(actors, robots=slice(None)):
    return Networks(actors.spec, actors.weights).outputs(OBSERVATION[:, robots][:, : actors.spec.robots])


def test_parts_and_joints_act_as_their_robots_did():
    first, second = team((0, 1, 0)), team((0,), seed=1)
    np.testing.assert_array_equal(outputs(expanded(first)), outputs(first))
    assert expanded(first).spec.networks == 3
    part = robots_of(first, 1, 3)
    np.testing.assert_array_equal(outputs(part, slice(1, 3)), outputs(first)[:, 1:3])
    both = joined(first, second)
    assert both.spec.of_robot == (0, 1, 0, 2)
    np.testing.assert_array_equal(outputs(both)[:, :3], outputs(first))
    np.testing.assert_array_equal(outputs(both)[:, 3:], outputs(second, slice(3, 4)))
    assert joined(None, second) is second


def test_teams_of_other_networks_are_not_joined():
    for other in (team((0,), output="logits"), team((0,), normalisation="rms")):
        with pytest.raises(InputError, match="must be false for networks that differ"):
            joined(team((0,)), other)


def test_frozen_robots_take_the_largest_output():
    actors = team((0, 1, 1, 0))
    frozen = FrozenTeam(actors)
    assert frozen.robots == 4
    np.testing.assert_array_equal(frozen.act(OBSERVATION), outputs(actors).argmax(axis=-1))
