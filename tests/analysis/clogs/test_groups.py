"""Who is held up, who is linked, and what is a group, one condition at a time."""

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_array_equal

from robosim.analysis.clogs.groups import GroupFinder
from robosim.analysis.measure.tunnels import find_tunnels
from robosim.world.contacts import ContactKind
from tests.analysis.handmade import HOLD, LENGTH, REAL, Run, Script, columns_for, crowds, middle, real, runs
from tests.analysis.plain import PlainGroups, PlainRun

STEPS = 40
INSIDE, MOUTH, FLOOR = middle(12, 3), middle(7, 3), middle(6, 3)


def standing(*places, steps: int = STEPS) -> Script:
    """Robots that stand still and decide to go on, in `single-lane`; the home holds one more."""
    script = Script("single-lane", len(places) + 1, steps)
    for robot, place in enumerate(places):
        script.pose[:, robot, :2] = place
        script.action[1:, robot] = 3
    return script


def groups(script: Script | Run):
    """Groups of a whole run at once."""
    frames = script.frames() if isinstance(script, Script) else script.frames
    columns = columns_for(script.arena, script.robots, len(frames))
    for frame in frames:
        columns.add(frame)
    return GroupFinder(script.arena, script.robots, find_tunnels(script.arena)).find(columns)


def grouped(script: Script) -> list[int]:
    """The decisions after which robot 0 is in a group."""
    return np.flatnonzero(groups(script).label[:, 0] >= 0).tolist()


def pair() -> Script:
    script = standing(INSIDE, INSIDE)
    script.meet(range(1, STEPS + 1), 0, 1)
    return script


def test_two_that_touch_are_a_group_from_three_seconds_on():
    found = groups(pair())
    assert found.label[: HOLD + 1, 0].tolist() == [-1] * HOLD + [0]
    assert (found.label[HOLD:, 1] == 0).all()
    assert (found.label[:, 2] == -1).all()
    assert found.link[HOLD].tolist() == [[False, True, False], [True, False, False], [False] * 3]
    assert not found.pellet.any()


def test_one_touch_holds_for_three_seconds():
    script = standing(INSIDE, INSIDE)
    script.meet([20], 0, 1)
    assert grouped(script) == list(range(20, 20 + HOLD))


def test_half_of_the_decisions_must_have_been_to_move():
    script = pair()
    script.action[1:, 0] = np.where(np.arange(1, STEPS + 1) % 2 == 0, 3, 4)
    assert grouped(script) == list(range(HOLD, STEPS + 1))
    script.action[4::HOLD, 0] = 4
    assert grouped(script) == [], "four of ten"


def test_nobody_who_decided_to_stop_is_held_up():
    script = pair()
    script.action[:, 0] = 4
    assert grouped(script) == []
    assert (groups(script).label == -1).all(), "and its partner stands alone"


@pytest.mark.parametrize(
    ("displacement", "held"), [(0.5 * LENGTH - 1e-4, True), (0.5 * LENGTH + 1e-4, False)]
)
def test_less_than_half_a_length_in_three_seconds_is_no_headway(displacement, held):
    script = pair()
    script.pose[:, 0, 0] = INSIDE[0] + np.arange(STEPS + 1) * displacement / HOLD
    assert grouped(script) == (list(range(HOLD, STEPS + 1)) if held else [])


def test_where_it_went_in_between_does_not_matter():
    script = pair()
    script.pose[5::HOLD, 0, 0] += 1.0
    far = set(range(5, STEPS + 1, HOLD))
    assert set(range(HOLD, STEPS + 1)) - far <= set(grouped(script)), "away and back again"


def test_a_wall_alone_makes_no_group():
    script = standing(INSIDE, INSIDE)
    for robot in (0, 1):
        script.rub(range(1, STEPS + 1), robot)
    assert grouped(script) == []


def test_one_robot_with_a_loose_pellet_is_a_group():
    script = standing(INSIDE)
    script.press(range(1, STEPS + 1), 0, 7)
    assert grouped(script) == list(range(HOLD, STEPS + 1))
    assert groups(script).pellet[HOLD].tolist() == [True, False]


def test_two_at_the_same_pellet_at_once_are_linked():
    together, taking_turns, apart = (standing(INSIDE, INSIDE) for _ in range(3))
    for step in range(1, STEPS + 1):
        together.press([step], 0, 7)
        together.press([step], 1, 7)
        taking_turns.press([step], step % 2, 7)
        apart.press([step], 0, 7)
        apart.press([step], 1, 8)
    assert groups(together).link[HOLD, 0, 1]
    for script in (taking_turns, apart):
        found = groups(script)
        assert not found.link.any()
        assert found.label[HOLD].tolist() == [0, 1, -1], "each for itself"


def test_all_at_the_same_pellet_are_linked_whoever_moves_on():
    """Robot 1 lies between the two others in number, and is not held up."""
    script = standing(INSIDE, INSIDE, INSIDE)
    script.action[:, 1] = 4
    for robot in range(3):
        script.press(range(1, STEPS + 1), robot, 7)
    found = groups(script)
    assert found.link[HOLD, 0, 2]
    assert found.label[HOLD].tolist() == [0, -1, 0, -1]


@pytest.mark.parametrize(("place", "within"), [(INSIDE, True), (MOUTH, True), (FLOOR, False)])
def test_one_of_them_must_be_in_a_tunnel_or_its_mouth(place, within):
    script = standing(place, FLOOR, FLOOR)
    script.meet(range(1, STEPS + 1), 0, 1)
    script.meet(range(1, STEPS + 1), 1, 2)
    assert (groups(script).label[HOLD] == [0, 0, 0, -1]).all() == within
    assert bool(grouped(script)) == within


def test_links_reach_over_any_number_of_robots_but_not_over_one_that_moves():
    script = standing(*[INSIDE] * 7)
    for one, other in ((6, 0), (0, 5), (5, 1), (1, 4), (4, 2)):
        script.meet(range(1, STEPS + 1), one, other)
    assert groups(script).label[HOLD].tolist() == [0, 0, 0, -1, 0, 0, 0, -1]
    script.action[:, 5] = 4
    assert groups(script).label[HOLD].tolist() == [0, 1, 1, -1, 1, -1, 0, -1]


def test_walls_and_pellets_are_no_robots():
    """Pellet 1 and robot 1 share a number only."""
    script = standing(INSIDE, FLOOR)
    script.press(range(1, STEPS + 1), 0, 1)
    script.touch(range(1, STEPS + 1), ContactKind.ROBOT_WALL, 1, -1)
    found = groups(script)
    assert found.label[HOLD].tolist() == [0, -1, -1]
    assert not found.link.any()


def _same_as_plain(run):
    found, plain = groups(run), PlainGroups(PlainRun(run), HOLD)
    label = np.full((len(run.frames), run.robots), -1)
    link = np.zeros((len(run.frames), run.robots, run.robots), dtype=bool)
    pellet = np.zeros(label.shape, dtype=bool)
    for step, parts in enumerate(plain.groups):
        for group in parts:
            for one in group:
                label[step, one] = group[0]
                pellet[step, one] = plain.pressed(step, one)
                for other in group:
                    link[step, one, other] = plain.linked(step, one, other)
    assert_array_equal(found.label, label)
    assert_array_equal(found.link, link)
    assert_array_equal(found.pellet, pellet)


@pytest.mark.parametrize("name", REAL)
def test_real_runs_are_read_as_the_plain_reading_does(name):
    _same_as_plain(real(name))


@given(runs())
def test_any_run_is_read_as_the_plain_reading_does(run):
    _same_as_plain(run)


@given(crowds())
def test_any_crowd_is_read_as_the_plain_reading_does(run):
    _same_as_plain(run)
