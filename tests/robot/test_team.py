from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.robot.kinematics import body_twist, wheel_speeds_for
from robosim.robot.sheet import RobotSheet
from robosim.robot.team import Group, SheetArrays, Team, per_wheel

SMALL = RobotSheet(length=0.08, width=0.08, wheel_base=0.08, max_wheel_speed=6.0)
LONG = RobotSheet(shape="capsule", length=0.2, max_wheel_speed=20.0, max_wheel_acceleration=60.0)


@given(st.lists(st.integers(1, 5), min_size=1, max_size=4), st.integers(1, 30), st.integers(1, 30))
def test_robots_are_dealt_out_in_turn_and_keep_their_group_in_larger_teams(
    counts: list[int], robots: int, more: int
) -> None:
    groups = tuple(Group(f"g{index}", SMALL, count=count) for index, count in enumerate(counts))
    expected: list[int] = []
    while len(expected) < robots:
        for index, count in enumerate(counts):
            expected += [index] * count
    team = Team.dealt(groups, robots)
    assert team.group.tolist() == expected[:robots]
    assert team.names == tuple(f"g{index}" for index in expected[:robots])
    assert Team.dealt(groups, robots + more).group[:robots].tolist() == team.group.tolist()


def test_a_team_of_equals_has_numbers_in_place_of_arrays() -> None:
    equals = Team.dealt((Group("a", SMALL),), 3)
    assert equals.sheet is SMALL
    assert not equals.mixed
    # Of several groups, too, where their robots differ in nothing but the name.
    named = Team.dealt((Group("a", SMALL), Group("b", replace(SMALL))), 3)
    assert isinstance(named.sheet, RobotSheet)
    assert named.mixed
    assert equals.reach.tolist() == [[0.08]]


def test_a_mixed_team_has_what_each_sheet_says() -> None:
    team = Team.dealt((Group("small", SMALL, count=2), Group("long", LONG)), 4)
    sheet = team.sheet
    assert isinstance(sheet, SheetArrays)
    for one in fields(SheetArrays):
        expected = [getattr(each, one.name) for each in (SMALL, SMALL, LONG, SMALL)]
        assert getattr(sheet, one.name).tolist() == expected
    radius = [0.04, 0.04, 0.1, 0.04]
    assert team.reach.tolist() == [[a + b for b in radius] for a in radius]


def test_kinematics_of_a_mixed_team_are_those_of_each_robot() -> None:
    team = Team.dealt((Group("small", SMALL), Group("long", LONG)), 5)
    rng = np.random.default_rng(0)
    wheels = rng.uniform(-20.0, 20.0, (3, 5, 2))
    speed, rate = body_twist(team.sheet, wheels)
    again = wheel_speeds_for(team.sheet, speed, rate)
    for robot, sheet in enumerate(team.sheets):
        one_speed, one_rate = body_twist(sheet, wheels[:, robot])
        assert np.array_equal(speed[:, robot], one_speed)
        assert np.array_equal(rate[:, robot], one_rate)
        assert np.array_equal(again[:, robot], wheel_speeds_for(sheet, one_speed, one_rate))


@pytest.mark.parametrize(("value", "shape"), [(1.5, ()), (np.array([1.0, 2.0]), (2, 1))])
def test_values_of_robots_stand_beside_those_of_wheels(value: float, shape: tuple[int, ...]) -> None:
    assert per_wheel(value).shape == shape
