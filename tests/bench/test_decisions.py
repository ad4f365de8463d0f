import pytest

from robosim.bench.decisions import Cost, measure


def test_what_is_derived_from_a_cost() -> None:
    cost = Cost(robots=8, envs=16, pellets=60, decisions=1600, seconds=2.0, floor_seconds=0.5)
    assert cost.joint_decisions_per_second == 800.0
    assert cost.robot_decisions_per_second == 6400.0
    assert cost.floor_share == 0.25
    assert cost.ratio == 4.0
    assert cost.as_record()["ratio"] == 4.0
    assert cost.as_record()["pellets"] == 60


def test_a_small_measurement_holds_together() -> None:
    """The floor is a part of the whole, and every case comes with and without pellets."""
    costs = list(measure(4, robots=(1, 2), envs=(1, 2)))
    assert [(c.robots, c.envs, c.pellets) for c in costs] == [
        (robots, envs, pellets) for robots in (1, 2) for envs in (1, 2) for pellets in (60, 0)
    ]
    assert [c.decisions for c in costs] == [4, 4, 2, 2] * 2
    for cost in costs:
        assert 0.0 < cost.floor_seconds < cost.seconds
        assert cost.ratio == pytest.approx(1.0 / cost.floor_share)
