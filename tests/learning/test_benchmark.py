import sys
from dataclasses import replace

import numpy as np
import pytest

from robosim.learning import benchmark
from robosim.learning.benchmark import (
    TEAM,
    Comparison,
    UpdateCost,
    bare_products,
    compare_with_stable_baselines3,
    measure_one_for_all,
    measure_updates,
    time_in_turns,
)
from robosim.learning.precision import rounds_to_bfloat16
from tests.learning.products import PROCESSORS

SMALL = replace(TEAM, robots=2, inputs=8, hidden=(16, 16))


@pytest.fixture(autouse=True)
def small_replay(monkeypatch):
    monkeypatch.setattr(benchmark, "TRANSITIONS", 200)


def test_what_is_derived_from_a_cost():
    cost = UpdateCost(8, 64, "float32", seconds=0.004, products_seconds=0.002, single_seconds=0.001)
    assert cost.ratio == 2.0
    assert cost.team_share == 0.5
    assert cost.robot_updates_per_second == 2000.0
    assert cost.as_record()["ratio"] == 2.0
    assert cost.as_record()["batch_size"] == 64
    assert Comparison("2", 64, 3000.0, 500.0).as_record()["ratio"] == 6.0


@pytest.mark.parametrize("processor", PROCESSORS)
def test_every_batch_size_is_measured_in_every_precision_there_is(monkeypatch, processor):
    rounds = processor(monkeypatch)
    costs = list(measure_updates(1, SMALL, (4, 8)))
    if rounds is None:
        rounds = rounds_to_bfloat16(replace(SMALL, robots=1), 8)
    precisions = ["float32", "bfloat16"] if rounds else ["float32"]
    assert [(c.batch_size, c.precision) for c in costs] == [(b, p) for b in (4, 8) for p in precisions]
    for cost in costs:
        assert cost.robots == 2
        assert cost.seconds > cost.products_seconds > 0.0
        assert cost.single_seconds > 0.0


def test_one_network_for_all_is_measured_as_ps_dqn_learns():
    cost = measure_one_for_all(1, replace(SMALL, robots=1, normalised=True), 8)
    assert (cost.robots, cost.batch_size, cost.precision) == (1, 8, "float32")
    assert cost.seconds > cost.products_seconds > 0.0


def test_all_that_is_compared_is_called_in_turns_and_equally_often():
    calls = []
    seconds = time_in_turns([lambda: calls.append("a"), lambda: calls.append("b")], 15)
    assert "".join(calls) == 2 * (11 * "a" + 11 * "b")
    assert len(seconds) == 2


def test_bare_products_are_those_of_an_update(monkeypatch):
    """Three passes, and two products for the gradient of each layer but the first, which needs one."""
    made = []
    bmm = benchmark.torch.bmm

    def counted(left, right, out):
        made.append(left.shape[0] * left.shape[1] * left.shape[2] * right.shape[2])
        return bmm(left, right, out=out)

    monkeypatch.setattr(benchmark.torch, "bmm", counted)
    bare_products(SMALL, 4)()
    layers = np.array([8 * 16, 16 * 16, 16 * 5])
    assert len(made) == 3 * 3 + 2 * 3 - 1
    assert sum(made) == 2 * 4 * (3 * layers.sum() + layers.sum() + layers[1:].sum())


def test_comparison_with_another_library():
    pytest.importorskip("stable_baselines3")
    other = compare_with_stable_baselines3(1, SMALL, 4)
    assert other.batch_size == 4
    assert other.robot_updates_per_second > 0.0
    assert other.other_updates_per_second > 0.0


def test_no_comparison_without_the_other_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    assert compare_with_stable_baselines3(1, SMALL) is None
