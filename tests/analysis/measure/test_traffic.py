"""Visits, flow and density, and who is where: made by hand, and by the plain reading of real runs."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from robosim.analysis.measure.traffic import ACTIVE_WINDOW, PER_CELL, TRACK_TIME, WINDOW, lapses, segregation
from robosim.analysis.measure.visits import End
from robosim.arena import parse_arena
from tests.analysis.handmade import LENGTH, PERIOD, REAL, ROOM, TOP, Script, middle, real, runs, small
from tests.analysis.plain import (
    AT_HOME,
    PlainCounts,
    PlainRun,
    is_passage,
    plain_activity,
    plain_visits,
    plain_windows,
)

OUT, BACK = middle(6, 3), middle(20, 3)
"""Before either end of the tunnel of `paper`, whose cells are 8 to 18: from x = 1.2 m to 2.85 m."""


def through(steps: int = 60) -> Script:
    """Robot 0 goes from before the tunnel to behind it in 42 decisions of 5 cm."""
    script = Script("paper", 2, steps)
    script.drive(0, [(0, *OUT), (42, *BACK)])
    return script


def test_a_visit_lasts_from_the_first_decision_inside_to_the_first_outside():
    """x = 0.975 + 0.05 n: over 1.2 m from n = 5 on (1.225 m), past 2.85 m at n = 38 (2.875 m)."""
    traffic = through().watch().traffic
    (visit,) = traffic.visits
    assert visit[:6] == (0, 0, 5, 38, End.HOME, End.SOURCE)
    assert visit.deepest == pytest.approx(2.825 - 1.2)
    assert visit.passage
    assert not visit.is_reversal(LENGTH)


def test_a_visit_is_a_reversal_when_a_robots_length_deep():
    script = Script("paper", 2, 40)
    script.drive(0, [(0, *OUT), (6, 1.275, OUT[1]), (20, *OUT)])
    script.drive(1, [(0, *BACK), (20, 2.85 - LENGTH - 0.001, BACK[1]), (40, *BACK)])
    short, long = script.watch().traffic.visits
    assert (short.robot, short.entered, short.left) == (0, End.HOME, End.HOME)
    assert short.deepest == pytest.approx(0.075)
    assert not short.is_reversal(LENGTH)
    assert (long.robot, long.entered, long.left) == (1, End.SOURCE, End.SOURCE)
    assert long.deepest == pytest.approx(LENGTH + 0.001)
    assert long.is_reversal(LENGTH)
    assert not short.passage
    assert not long.passage


def test_a_visit_that_began_before_the_run_or_outlasts_it_is_no_passage():
    script = Script("paper", 3, 20)
    script.drive(0, [(0, *middle(12, 3)), (20, *BACK)])
    script.drive(1, [(0, *BACK), (20, *middle(12, 4))])
    script.pose[:, 2, :2] = middle(12, 3)
    born, gone, stuck = script.watch().traffic.visits
    assert born[:2] == (0, 0)
    assert (born.start, born.entered, born.left) == (0, End.NOWHERE, End.SOURCE)
    # 6 cm a decision from 1.875 m on: 16 of them end before 2.85 m.
    assert (born.end, born.deepest) == (17, pytest.approx(16 * 0.06))
    assert (gone.robot, gone.end, gone.entered, gone.left) == (1, 21, End.SOURCE, End.NOWHERE)
    assert stuck == (2, 0, 0, 21, End.NOWHERE, End.NOWHERE, 0.0)
    assert not any(visit.passage or visit.is_reversal(LENGTH) for visit in (born, gone, stuck))


def test_flow_is_density_times_speed_for_a_robot_at_constant_speed():
    """1.5 cm a decision is 0.05 m/s; inside for a whole window, one robot in 1.65 m: q = k v."""
    script = Script("paper", 1, 120)
    script.drive(0, [(0, 1.2 - 0.0151, OUT[1]), (120, 1.2 - 0.0151 + 1.8, OUT[1])])
    windows = script.watch().traffic.windows
    assert windows.tunnel.tolist() == [0]
    # The first decision, n = 1, ends 0.1 mm before the tunnel; the 99 others of the window are inside.
    assert windows.density[0] == pytest.approx(0.99 / 1.65)
    assert windows.flow[0] == pytest.approx(windows.density[0] * 0.05, rel=1e-9)


def test_flow_counts_the_approach_to_the_goal_whichever_it_is():
    """A laden robot homeward and an unladen one outward add up; the other directions count against."""
    flows = []
    for loads in ((False, True), (True, True), (False, False), (True, False)):
        script = Script("paper", 2, 100)
        script.drive(0, [(0, 1.3, OUT[1]), (100, 2.3, OUT[1])])
        script.drive(1, [(0, 2.7, middle(0, 4)[1]), (100, 2.2, middle(0, 4)[1])])
        script.laden[:] = loads
        flows += script.watch().traffic.windows.flow.tolist()
    area = 1.65 * 30.0
    assert flows == pytest.approx([1.5 / area, -0.5 / area, 0.5 / area, -1.5 / area])


def test_to_and_fro_is_no_flow():
    script = Script("paper", 1, 100)
    script.drive(0, [(0, 1.3, OUT[1]), (50, 2.3, OUT[1]), (100, 1.3, OUT[1])])
    windows = script.watch().traffic.windows
    assert windows.density == pytest.approx([1 / 1.65])
    assert windows.flow == pytest.approx([0.0], abs=1e-12)


def test_what_a_robot_held_before_a_decision_says_where_it_was_bound():
    """It takes its pellet in the decision that brought it there, which was still outward."""
    script = Script("paper", 1, 100)
    script.drive(0, [(0, 1.3, OUT[1]), (50, 2.3, OUT[1]), (100, 1.3, OUT[1])])
    script.laden[50:] = True
    assert script.watch().traffic.windows.flow == pytest.approx([2.0 / (1.65 * 30.0)])


def test_each_tunnel_has_its_windows():
    """Only whole windows count: 201 decisions are two of 100."""
    script = Script("two-tunnels", 3, 201)
    script.pose[:, 0, :2], script.pose[:, 1, :2] = middle(12, 6), middle(13, 6)
    script.pose[100:151, 2, :2] = middle(12, 2)
    windows = script.watch().traffic.windows
    assert windows.tunnel.tolist() == [0, 1, 0, 1]
    assert windows.density == pytest.approx(np.array([0.01, 2.0, 0.5, 2.0]) / 1.65)


def test_robots_in_the_tunnels_are_counted_after_each_decision():
    """Alone, then two of the same kind, then of both kinds; the state at the start counts nowhere.

    Only who moves along is traffic: a quarter of the top speed along the tunnel, and no less.
    """
    script = Script("paper", 3, 60)
    to_and_fro = 0.26 * TOP * (np.arange(61) % 2)[:, None] * (1.0, 0.0)
    script.pose[0:41, 0, :2] = middle(10, 3) + to_and_fro[:41]
    script.pose[11:41, 1, :2] = middle(12, 3) + to_and_fro[11:41]
    script.laden[21:, 1] = True
    traffic = script.watch().traffic
    assert traffic.robots_in_tunnel.tolist() == [20, 10, 30, 0]
    assert traffic.bidirectional == 20
    assert traffic.unladen_cells[3, 10] == 40
    assert traffic.unladen_cells[3, 12] == 10
    assert traffic.laden_cells[3, 12] == traffic.laden_cells.sum() == 20
    slower = Script("paper", 3, 60)
    slower.pose[:], slower.laden[:] = script.pose, script.laden
    slower.pose[..., 0] -= np.where(np.arange(61) % 2, 0.02 * TOP, 0.0)[:, None]
    stuck = slower.watch().traffic
    assert stuck.robots_in_tunnel.tolist() == [20, 10, 30, 0]
    assert stuck.bidirectional == stuck.laden_cells.sum() == 0
    assert stuck.unladen_cells.sum() == 1, "that of the robot that appears out of nowhere"
    assert traffic.occupancy.sum() == 3 * 60, "everywhere, not only in the tunnels"
    assert traffic.occupancy[3 * PER_CELL + 2, 10 * PER_CELL + 2] == 40


@pytest.mark.parametrize(("rows", "expected"), [((3, 4), 1.0), ((3, 3), 0.0)])
def test_lanes_of_their_own_differ_from_a_shared_one(rows, expected):
    script = Script("paper", 2, 33)
    for robot, row in enumerate(rows):
        script.drive(robot, [(0, *middle(8, row)), (33, *middle(18.9, row))])
    script.laden[:, 1] = True
    assert segregation(script.watch().traffic) == pytest.approx(expected)


def test_half_a_shared_lane_is_half_a_segregation():
    """Unladen in cells A and B half the time each, laden in B and C: D = (1/2 + 0 + 1/2) / 2."""
    script = Script("paper", 2, 40)
    for robot in (0, 1):
        script.pose[:21, robot, :2], script.pose[21:, robot, :2] = (
            middle(10 + robot, 3),
            middle(11 + robot, 3),
        )
        script.pose[:, robot, 0] += 0.3 * TOP * (np.arange(41) % 2)
    script.laden[:, 1] = True
    assert segregation(script.watch().traffic) == pytest.approx(0.5)


def test_segregation_wants_both_kinds():
    script = Script("paper", 2, 20)
    script.pose[:, :, :2] = middle(10, 3)
    assert segregation(script.watch().traffic) is None


def test_lapses_are_those_of_each_tunnel_and_one_decision_is_one_passage():
    script = Script("two-tunnels", 5, 90)
    lanes = [(0, 6), (0, 6), (10, 6), (25, 6), (7, 2)]
    for robot, (begin, row) in enumerate(lanes):
        script.pose[: begin + 1, robot, :2] = middle(6, row)
        script.drive(robot, [(begin, *middle(6, row)), (begin + 42, *middle(20, row))])
    traffic = script.watch().traffic
    assert sum(visit.passage for visit in traffic.visits) == 5
    assert lapses(traffic, PERIOD) == pytest.approx([3.0, 4.5])


def test_lapses_of_two_tunnels_are_not_mixed():
    script = Script("two-tunnels", 4, 90)
    for robot, (begin, row) in enumerate([(0, 6), (1, 2), (20, 6), (31, 2)]):
        script.pose[: begin + 1, robot, :2] = middle(6, row)
        script.drive(robot, [(begin, *middle(6, row)), (begin + 42, *middle(20, row))])
    assert sorted(lapses(script.watch().traffic, PERIOD)) == pytest.approx([6.0, 9.0])


def test_activity_is_of_whole_stretches():
    """120 s are 400 decisions. One robot of two in the first stretch, none in the second."""
    script = Script("paper", 2, 900)
    script.pose[400, 0, :2] = middle(10, 3)
    script.pose[801:, :, :2] = middle(10, 3)
    assert round(ACTIVE_WINDOW / PERIOD) == 400
    assert script.watch().traffic.active.tolist() == [0.5, 0.0]


def test_stops_are_what_robots_decided_not_what_they_did():
    script = Script("paper", 2, 30)
    script.action[1:11, 0] = 0
    assert script.watch().traffic.stops.tolist() == [20, 30]


def test_tracks_have_a_point_each_second_and_a_half():
    script = through(58)
    script.laden[30:, 0] = True
    traffic = script.watch().traffic
    every = round(TRACK_TIME / PERIOD)
    assert traffic.track_step.tolist() == list(range(0, 59, every))
    x = script.pose[::every, 0, 0]
    assert traffic.track[:, 0] == pytest.approx(x - 0.75, abs=1e-5)
    # The mouth belongs to it: cells 7 to 19.
    assert traffic.track_tunnel[:, 0].tolist() == np.where((x > 1.05) & (x < 3.0), 0, -1).tolist()
    assert traffic.track_laden[:, 0].tolist() == (traffic.track_step >= 30).tolist()
    assert (traffic.track_tunnel[:, 1] == -1).all()


def test_windows_follow_the_arenas_timing():
    arena = parse_arena(
        small().text + "\n[timing]\ncontrol_period = 0.1\ndecision_period = 1.0\n", "slow.toml"
    )
    script = Script(arena, 1, 61)
    script.pose[..., :2] = (3.5 * ROOM, 3.5 * ROOM)
    traffic = script.watch().traffic
    assert len(traffic.windows.tunnel) == 2 * 2
    assert sorted(traffic.windows.density) == pytest.approx([0.0, 0.0, 1 / 0.3, 1 / 0.3])


def test_a_visit_ends_where_another_tunnel_begins():
    """Tunnels that touch at a corner: a robot may change from one to the other in one decision."""
    text = small().text.replace("#H.TT.SS#\n#H.##.SS#\n#H.TTT..#", "#H.TT.SS#\n#H..#TSS#\n#H.TT...#")
    script = Script(parse_arena(text, "corner.toml"), 1, 20)
    script.pose[5:, 0, :2] = middle(4, 3)
    script.pose[10:, 0, :2] = middle(5, 2)
    script.pose[15:, 0, :2] = middle(6, 2)
    first, second = script.watch().traffic.visits
    assert (first.start, first.end, second.start, second.end) == (5, 10, 10, 15)
    assert first.tunnel != second.tunnel


def _same_as_plain(run):
    traffic, plain = run.watch().traffic, PlainRun(run)
    expected = plain_visits(plain)
    assert [visit[:6] for visit in traffic.visits] == [visit[:6] for visit in expected]
    assert [visit.deepest for visit in traffic.visits] == pytest.approx([visit[6] for visit in expected])
    assert [visit.passage for visit in traffic.visits] == [is_passage(visit) for visit in expected]
    length = run.arena.robot.length
    assert [visit.is_reversal(length) for visit in traffic.visits] == [
        visit[4] == visit[5] >= AT_HOME and visit[6] >= length for visit in expected
    ]
    windows = plain_windows(plain, round(WINDOW / plain.period))
    assert traffic.windows.tunnel.tolist() == [window[0] for window in windows]
    assert traffic.windows.density == pytest.approx([window[1] for window in windows], abs=1e-12)
    assert traffic.windows.flow == pytest.approx([window[2] for window in windows], abs=1e-12)
    assert traffic.active.tolist() == plain_activity(plain, round(ACTIVE_WINDOW / plain.period))
    counts = PlainCounts(plain, PER_CELL)
    assert traffic.robots_in_tunnel.tolist() == counts.robots_in_tunnel
    assert traffic.bidirectional == counts.bidirectional
    assert traffic.stops.tolist() == counts.stops
    for laden, cells in ((False, traffic.unladen_cells), (True, traffic.laden_cells)):
        found = {(laden, int(r), int(c)): int(cells[r, c]) for r, c in np.argwhere(cells)}
        assert found == {key: count for key, count in counts.cells.items() if key[0] == laden}
    squares = {(int(r), int(c)): int(traffic.occupancy[r, c]) for r, c in np.argwhere(traffic.occupancy)}
    assert squares == counts.occupancy
    ends = [
        sorted({visit[3] for visit in expected if is_passage(visit) and visit[1] == tunnel})
        for tunnel in range(plain.count)
    ]
    expected_lapses = [b - a for times in ends for a, b in pairwise(times)]
    assert lapses(traffic, plain.period) == pytest.approx(np.array(expected_lapses) * plain.period)


@pytest.mark.parametrize("name", REAL)
def test_real_runs_are_read_as_the_plain_reading_does(name):
    _same_as_plain(real(name))


@given(runs())
def test_any_run_is_read_as_the_plain_reading_does(run):
    _same_as_plain(run)


@given(runs(least=380, most=420))
def test_longer_runs_too(run):
    """So long that windows close and robots are active."""
    _same_as_plain(run)


def test_top_speed_is_six_centimetres_a_decision():
    """What other tests of this folder take for granted."""
    robot = small().robot
    assert robot.top_speed * PERIOD == pytest.approx(TOP)
    assert robot.length == LENGTH
