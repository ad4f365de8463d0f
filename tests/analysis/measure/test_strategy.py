"""Which strategy is found, and from which numbers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.analysis.measure.strategy import PASSAGES, Strategy, classify
from robosim.analysis.measure.visits import End, Visit
from tests.analysis.handmade import Script, middle, without_tunnel

ONE, BUCKET, NEITHER = Strategy.ONE_AT_A_TIME, Strategy.BUCKET_BRIGADE, Strategy.NEITHER
ROUND = 100


def lanes(starts, rows=(3, 4), rounds: int = 6, robots: int = 2) -> Script:
    """Robots that go out in one row and, laden, home in the other, each from its own time of the round on."""
    script = Script("paper", robots, ROUND * rounds + max(starts))
    out, home = (middle(0, row)[1] for row in rows)
    for robot, start in enumerate(starts):
        for begin in range(start, start + ROUND * rounds, ROUND):
            path = [
                (0, 0.975, out),
                (45, 3.225, out),
                (50, 3.225, home),
                (95, 0.975, home),
                (100, 0.975, out),
            ]
            script.drive(robot, [(begin + step, x, y) for step, x, y in path])
            script.laden[begin + 48 : begin + 98, robot] = True
    return script


def found(script: Script) -> Strategy:
    return classify(script.watch()).strategy


def test_one_that_goes_while_the_other_waits_is_one_at_a_time():
    """Robot 1 never leaves the home."""
    verdict = classify(lanes([0]).watch())
    assert verdict.strategy is ONE
    assert verdict.reason == "alone 100 % of the time in use, both directions at once 0 %, segregation 1.00"


def test_both_directions_in_lanes_of_their_own_is_a_bucket_brigade():
    verdict = classify(lanes([0, 50]).watch())
    assert verdict.strategy is BUCKET
    assert "segregation 1.00" in verdict.reason


def test_both_directions_in_the_same_lane_is_neither():
    assert found(lanes([0, 50], rows=(3, 3))) is NEITHER


def test_a_convoy_is_neither():
    """Two at once, but never against each other."""
    script = lanes([0, 4])
    assert found(script) is NEITHER


def test_taking_turns_is_one_at_a_time():
    """Each goes when the other is back."""
    script = Script("paper", 2, 1300)
    for begin in range(0, 1200, 200):
        for robot in (0, 1):
            at = begin + 100 * robot
            script.drive(robot, [(at, 0.975, 0.5), (at + 45, 3.225, 0.5), (at + 90, 0.975, 0.5)])
            script.laden[at + 45 : at + 90, robot] = True
    assert found(script) is ONE


def test_one_robot_has_no_strategy():
    verdict = classify(lanes([0], robots=1).watch())
    assert verdict == (NEITHER, "one robot")


def test_few_passages_show_none():
    """Four rounds of two passages each; the fifth makes ten."""
    assert classify(lanes([0], rounds=4).watch()) == (NEITHER, "8 passages, fewer than 10")
    assert found(lanes([0], rounds=5)) is ONE


def test_no_tunnel_no_strategy():
    assert found(Script(without_tunnel(), 2, 30)) is NEITHER


def counted(alone: int, more: int, both: int, apart: int, passages: int = PASSAGES):
    """An episode with so many decisions of each kind; `apart` of 100 laden ones in cells of their own."""
    episode = Script("paper", 3, 1).watch()
    cells = np.zeros_like(episode.traffic.laden_cells)
    unladen, laden = cells.copy(), cells.copy()
    unladen[3, 10], laden[3, 10], laden[4, 10] = 100, 100 - apart, apart
    traffic = replace(
        episode.traffic,
        visits=[Visit(0, 0, 0, 9, End.HOME, End.SOURCE, 1.6)] * passages,
        robots_in_tunnel=np.array([50, alone, more, 0]),
        bidirectional=both,
        unladen_cells=unladen,
        laden_cells=laden,
    )
    return replace(episode, traffic=traffic)


@pytest.mark.parametrize(
    ("alone", "both", "apart", "expected"),
    [
        (80, 20, 100, ONE),
        (79, 21, 100, BUCKET),
        (79, 20, 60, BUCKET),
        (79, 19, 60, NEITHER),
        (79, 21, 59, NEITHER),
        (0, 100, 0, NEITHER),
    ],
)
def test_where_one_strategy_ends_and_the_other_begins(alone, both, apart, expected):
    assert classify(counted(alone, 100 - alone, both, apart)).strategy is expected


@given(st.integers(0, 50), st.integers(0, 50), st.integers(0, 50), st.integers(0, 100), st.integers(8, 12))
def test_any_counts_are_classified_by_the_definition(alone, more, both, apart, passages):
    both = min(both, more)
    used = alone + more
    expected = NEITHER
    if passages >= 10 and used > 0:
        if 10 * alone >= 8 * used:
            expected = ONE
        elif 10 * both >= 2 * used and apart >= 60:
            expected = BUCKET
    assert classify(counted(alone, more, both, apart, passages)).strategy is expected
