import pytest

from robosim.errors import InputError
from robosim.learning.algorithms import registry
from robosim.learning.algorithms.dqn.config import DqnConfig
from robosim.learning.algorithms.ia2c import Ia2cConfig
from robosim.learning.algorithms.protocol import AlgorithmConfig
from robosim.learning.algorithms.registry import algorithm_names, find_algorithm, register_algorithm
from robosim.learning.config import RunConfig


def test_algorithms_that_ship_are_found_by_name():
    assert find_algorithm("dqn") is DqnConfig
    assert find_algorithm("ia2c") is Ia2cConfig
    assert {"dqn", "ia2c", "madqn", "pqn", "qmix"} <= set(algorithm_names())
    with pytest.raises(InputError, match='unknown algorithm "dqm": did you mean dqn'):
        find_algorithm("dqm")


def test_one_that_is_registered_is_known_to_configurations(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTERED", {})

    @register_algorithm
    class Mine(AlgorithmConfig):
        name: str = "mine"
        knob: float = 0.5

        def build(self, task, seed, start=None):
            raise NotImplementedError

    assert find_algorithm("mine") is Mine
    config = RunConfig(algorithm={"name": "mine", "knob": 0.75})
    assert config.algorithm == Mine(knob=0.75)
    assert config.with_options(knob=0.25, robots=3).algorithm.knob == 0.25
