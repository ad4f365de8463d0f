"""Trips and what they took: by hand, and by the plain reading of real runs."""

import numpy as np
import pytest
from hypothesis import given

from robosim.analysis.measure.trips import TripLog
from robosim.discretise.modes import Mode
from robosim.world.contacts import ContactKind
from tests.analysis.handmade import PERIOD, REAL, Script, columns_for, real, runs
from tests.analysis.plain import PlainRun, PlainTallies, plain_trips

ROBOT, WALL, PELLET = ContactKind.ROBOT_ROBOT, ContactKind.ROBOT_WALL, ContactKind.ROBOT_PELLET


def test_a_trip_lasts_from_delivery_to_delivery_and_its_modes_fill_it():
    """Ten decisions in Exit-Home, 20 in Going-to-Dig, five in Digging, 15 in Going-Home; then 30 more."""
    script = Script("paper", 2, 90)
    script.mode[1:11, 0], script.mode[11:31, 0] = Mode.EXIT_HOME, Mode.GOING_TO_DIG
    script.mode[31:36, 0], script.mode[36:51, 0] = Mode.DIGGING, Mode.GOING_HOME
    script.mode[51:, 0] = Mode.COLLISION
    script.delivered[50:, 0] = 1
    script.delivered[80:, 0] = 3
    first, second = script.watch().trips
    assert first[:4] == (0, 0, 50, 1)
    assert second[:4] == (0, 50, 80, 2)
    expected = dict.fromkeys(Mode, 0.0)
    expected |= {Mode.EXIT_HOME: 3.0, Mode.GOING_TO_DIG: 6.0, Mode.DIGGING: 1.5, Mode.GOING_HOME: 4.5}
    assert first.seconds == pytest.approx(tuple(expected.values()))
    assert sum(first.seconds) == pytest.approx(50 * PERIOD)
    assert second.seconds[Mode.COLLISION] == sum(second.seconds) == pytest.approx(9.0)


def test_totals_have_unfinished_trips_too():
    script = Script("paper", 2, 30)
    script.delivered[20:, 0] = 1
    script.energy[:] = np.arange(31)[:, None] * [0.5, 0.25]
    script.rub([5, 25], 0)
    episode = script.watch()
    (trip,) = episode.trips
    assert trip.energy == pytest.approx(10.0)
    assert trip.contacts[WALL] == 1
    totals = episode.totals
    assert totals.delivered.tolist() == [1, 0]
    assert totals.seconds.sum(axis=1) == pytest.approx([9.0, 9.0])
    assert totals.energy == pytest.approx([15.0, 7.5])
    assert totals.contacts[:, WALL].tolist() == [2, 0]


def test_trips_are_in_the_order_of_their_ends():
    script = Script("paper", 3, 20)
    script.delivered[15:, 0] = 1
    script.delivered[10:, 1] = 1
    script.delivered[10:, 2] = 2
    assert [(trip.robot, trip.end) for trip in script.watch().trips] == [(1, 10), (2, 10), (0, 15)]


def test_a_touch_goes_on_over_a_pause_of_a_decision_but_not_longer():
    """Contacts at 1.2, 1.5 (a decision later), 1.9 (0.4 s later) and 2.5 s: three touches."""
    script = Script("paper", 2, 20)
    for tenths in (12, 15, 19, 25):
        script.meet([(tenths + 2) // 3], 0, 1, period=(tenths - 1) % 3)
    times = [row[0] for rows in script.contacts for row in rows]
    assert times == pytest.approx([1.2, 1.5, 1.9, 2.5])
    assert script.watch().totals.contacts[:, ROBOT].tolist() == [3, 3]


def test_touches_of_different_bodies_are_different_touches():
    script = Script("paper", 3, 10)
    script.meet([3], 0, 1)
    script.meet([3], 0, 2)
    script.press([3], 0, 1)
    script.press([3], 0, 2)
    script.press([3], 1, 2)
    script.rub([3], 0)
    script.rub([3], 2)
    assert script.watch().totals.contacts.tolist() == [[2, 1, 2], [1, 0, 1], [1, 1, 0]]


def test_a_lasting_touch_is_one():
    script = Script("paper", 1, 1200)
    for period in range(3):
        script.rub(range(1, 1201), 0, period=period)
    assert script.watch().totals.contacts[:, WALL].tolist() == [1]


@pytest.mark.parametrize("size", [1, 2, 20])
def test_a_touch_that_the_run_begins_with_is_none_of_its_own(size):
    """Contacts of the first frame are before the first decision; the next touch is the first."""
    script = Script("paper", 2, 20)
    script.meet([0, 1, 2, 10], 0, 1)
    assert script.watch(size).totals.contacts[:, ROBOT].tolist() == [1, 1]


def test_impulse_counts_for_both_and_for_all_substeps():
    """0.02 N s in the last of 12 substeps, at the ends of two control periods."""
    script = Script("paper", 3, 10)
    script.meet([4], 0, 2, impulse=0.02, period=0)
    script.meet([4], 0, 2, impulse=0.02, period=1)
    script.press([4], 1, 0, impulse=5.0)
    script.rub([4], 1, impulse=5.0)
    script.delivered[6:, 2] = 1
    episode = script.watch()
    assert episode.arena.timing.substeps == 12
    assert episode.totals.impulse == pytest.approx([0.48, 0.0, 0.48])
    assert episode.trips[0].impulse == pytest.approx(0.48)


def test_nothing_is_a_trip_without_a_delivery():
    episode = Script("paper", 2, 20).watch()
    assert episode.trips == []
    assert episode.totals.delivered.tolist() == [0, 0]


def test_a_log_knows_nothing_of_how_columns_are_used_again():
    """What it keeps are copies: the same columns hold the next chunk."""
    script = Script("paper", 1, 20)
    script.delivered[8:], script.delivered[16:] = 1, 2
    script.energy[:, 0] = np.arange(21)
    log, columns = TripLog(script.arena, 1), columns_for(script.arena, 1, 7)
    for frame in script.frames():
        if columns.add(frame):
            log.add(columns)
            columns.clear()
            columns.delivered[:], columns.energy[:] = -99, np.nan
    assert [trip[:4] for trip in log.trips] == [(0, 0, 8, 1), (0, 8, 16, 1)]
    assert log.totals().energy.tolist() == [20.0]


def _same_as_plain(run):
    episode, plain = run.watch(), PlainRun(run)
    assert [trip[:4] for trip in episode.trips] == plain_trips(plain)
    for trip in episode.trips:
        tallies = PlainTallies(plain, trip.robot, trip.start, trip.end, len(Mode))
        assert trip.seconds == pytest.approx(tallies.seconds)
        assert list(trip.contacts) == tallies.contacts
        assert trip.impulse == pytest.approx(tallies.impulse)
        assert trip.energy == pytest.approx(tallies.energy)
    totals = episode.totals
    assert totals.delivered.tolist() == run.frames[-1].delivered.tolist()
    for robot in range(run.robots):
        tallies = PlainTallies(plain, robot, 0, plain.last, len(Mode))
        assert totals.seconds[robot] == pytest.approx(tallies.seconds)
        assert totals.contacts[robot].tolist() == tallies.contacts
        assert totals.impulse[robot] == pytest.approx(tallies.impulse)
        assert totals.energy[robot] == pytest.approx(tallies.energy)


@pytest.mark.parametrize("name", REAL)
def test_real_runs_are_read_as_the_plain_reading_does(name):
    _same_as_plain(real(name))


def test_real_runs_have_something_to_read():
    totals = real("reckless on three-wide").watch().totals
    assert totals.delivered.sum() > 10
    assert (totals.contacts.sum(axis=0) > 20).all()
    assert (totals.impulse > 0.0).any()
    assert (totals.energy > 0.0).all()


@given(runs())
def test_any_run_is_read_as_the_plain_reading_does(run):
    _same_as_plain(run)
