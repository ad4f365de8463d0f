"""Clogs made by hand: when they begin and end, why, and what is none; and the plain reading of real ones."""

import numpy as np
import pytest
from hypothesis import given, settings

from robosim.analysis.clogs.clog import SHORTEST, Cause, Ending, clogged_decisions, clogs_among
from robosim.analysis.clogs.finder import ClogFinder
from robosim.analysis.measure.tunnels import find_tunnels
from tests.analysis.handmade import (
    HOLD,
    LENGTH,
    PERIOD,
    REAL,
    TOP,
    Script,
    columns_for,
    crowds,
    middle,
    real,
    runs,
)
from tests.analysis.plain import PlainClogs, PlainRun

TRANSIT = 8.25
"""Of the shipped arenas' tunnels, s."""
HALT = 40
"""Decision after which robots have come to a halt."""
OVER = HALT + 70
"""First decision after which they are no longer held up: 21 s later, 2.5 transit times."""
STEPS = 160
X, Y = middle(12, 3)


def arrive(script: Script, robot: int, x: float, heading: int, y: float = Y, halt: int = HALT) -> None:
    """Drive along the tunnel to x at top speed, come to a halt, and go on trying."""
    begin = halt - 10
    script.pose[:begin, robot, :2] = x - heading * 10 * TOP, y
    script.drive(robot, [(begin, x - heading * 10 * TOP, y), (halt, x, y)])
    script.pose[:, robot, 2] = 0.0 if heading > 0 else np.pi
    script.action[1:, robot] = 3


def leave(script: Script, robot: int, heading: int, over: int = OVER, distance: float = 5 * TOP) -> None:
    """Drive away from where it stands, so that it is no longer held up after decision `over`."""
    let_go(script, over, STEPS + 1, robot)
    x, y = script.pose[over - 1, robot, :2]
    decisions = round(distance / TOP)
    script.drive(robot, [(over - 1, x, y), (over - 1 + decisions, x + heading * distance, y)])


def let_go(script: Script, begin: int, end: int, robot: int = 0) -> None:
    """Let a robot touch no other in decisions `begin` to `end` - 1."""
    for rows in script.contacts[begin:end]:
        rows[:] = [row for row in rows if robot not in row[2:4]]


def head_on(arena: str = "single-lane", robots: int = 3, steps: int = STEPS, y: float = Y) -> Script:
    """Robot 0, outward bound, and robot 1, laden and homeward bound, stand before each other."""
    script = Script(arena, robots, steps)
    arrive(script, 0, X, 1, y)
    arrive(script, 1, X + LENGTH, -1, y)
    script.laden[:, 1] = True
    script.meet(range(HALT, steps + 1), 0, 1)
    return script


def found(script: Script):
    return script.watch().standstills


def only(script: Script):
    (clog,) = found(script)
    return clog


def test_a_clog_begins_with_the_halt_and_ends_when_one_moves():
    """Recognised three seconds after the halt, and counted from it."""
    script = head_on()
    leave(script, 0, -1)
    clog = only(script)
    assert (clog.start, clog.end) == (HALT, OVER)
    assert clog.transits == pytest.approx(70 * PERIOD / TRANSIT)
    assert (clog.tunnel, clog.members) == (0, (0, 1))
    assert clog.cause is Cause.HEAD_ON
    assert clog.place == pytest.approx((X + 0.5 * LENGTH, Y))
    assert clog.distance == pytest.approx(X + 0.5 * LENGTH - 0.75)
    assert clogged_decisions([clog], STEPS) == 70


def test_it_is_reported_when_it_is_recognised_before_it_is_over():
    script = head_on()
    finder = ClogFinder(script.arena, 3, find_tunnels(script.arena))
    columns = columns_for(script.arena, 3, 1)
    seen = {}
    for frame in script.frames():
        columns.add(frame)
        distance = find_tunnels(script.arena).distance_to_home(columns.pose[:1, :, :2])
        finder.add(columns, distance, [])
        seen[frame.step] = finder.standing(transits=1.0)
        columns.clear()
    first = min(step for step, standing in seen.items() if standing)
    assert first == HALT + int(TRANSIT / PERIOD), "so many decisions are longer than one transit time"
    assert seen[first] == [(HALT, frozenset({0, 1}))]


def test_each_ending():
    """What the two do after the same clog, which begins and ends at the same time in all cases."""
    stories = {
        Ending.BACKED_OFF: lambda script: leave(script, 0, -1),
        Ending.WENT_ON: lambda script: leave(script, 1, -1),
        Ending.TOOK_PELLET: _takes_pellet,
        Ending.LET_GO: _lets_go,
        Ending.PASSAGE: lambda script: _passes(script, OVER),
        Ending.RUN_ENDED: lambda script: None,
    }
    assert set(stories) == set(Ending)
    for ending, happens in stories.items():
        steps = OVER - 1 if ending is Ending.RUN_ENDED else STEPS
        script = head_on(steps=steps)
        happens(script)
        clog = found(script)[0]
        assert (clog.ending, clog.start, clog.end) == (ending, HALT, OVER)


def _takes_pellet(script: Script) -> None:
    leave(script, 0, -1)
    script.laden[OVER + 3 :, 0] = True


def _lets_go(script: Script) -> None:
    """The last contact holds for HOLD decisions; nobody moves."""
    let_go(script, OVER - HOLD + 1, STEPS + 1)


def _passes(script: Script, leaves: int, robot: int = 2, arena_row: float = 3) -> None:
    """Another robot comes through, out of the tunnel after decision `leaves`; 28 decisions inside."""
    y = middle(0, arena_row)[1]
    begin = leaves - 36
    script.pose[:begin, robot, :2] = 0.73, y
    script.drive(robot, [(begin, 0.73, y), (begin + 46, 0.73 + 46 * TOP, y)])


def test_a_laden_robot_that_goes_on_goes_home():
    """The same direction is on for one and back for the other."""
    script = head_on()
    leave(script, 1, 1)
    assert only(script).ending is Ending.BACKED_OFF


def test_who_moves_most_says_how_it_ended():
    """The first to move has half a second more; the other follows, and for it that is forward."""
    script = head_on()
    leave(script, 0, -1, distance=5 * TOP)
    leave(script, 1, -1, over=OVER + 2, distance=4 * TOP)
    assert only(script).ending is Ending.BACKED_OFF


def test_a_pellet_taken_before_the_robot_has_turned_away_counts():
    """It turns on the spot, within three seconds of its last touch, and so is held up a little longer."""
    script = Script("single-lane", 1, STEPS)
    arrive(script, 0, X, 1)
    script.press(range(HALT, OVER - 4), 0, 5)
    script.laden[OVER - 4 :, 0] = True
    leave(script, 0, -1)
    clog = only(script)
    assert (clog.start, clog.end) == (HALT, OVER)
    assert clog.cause is Cause.PELLET
    assert clog.ending is Ending.TOOK_PELLET


def test_a_pellet_that_a_former_member_takes_elsewhere_is_none_of_it():
    """Robot 2 was behind robot 0 and left long ago; its pellet and path do not say how the others part."""
    script = head_on(robots=4)
    arrive(script, 2, X - LENGTH, 1)
    script.meet(range(HALT, HALT + 30), 0, 2)
    leave(script, 2, -1, over=HALT + 30)
    script.drive(2, [(OVER - 10, *middle(5, 3)), (OVER + 40, *middle(3, 5))])
    script.laden[OVER + 2 :, 2] = True
    _lets_go(script)
    clog = only(script)
    assert clog.members == (0, 1, 2)
    assert clog.end == OVER
    assert clog.ending is Ending.LET_GO


def test_a_queue_has_no_other_cause():
    script = Script("single-lane", 2, STEPS)
    arrive(script, 0, X, 1)
    arrive(script, 1, X - LENGTH, 1)
    script.meet(range(HALT, STEPS + 1), 0, 1)
    leave(script, 0, 1)
    clog = only(script)
    assert (clog.cause, clog.ending) == (Cause.QUEUE, Ending.WENT_ON)


@pytest.mark.parametrize(
    ("degrees", "cause"), [(59, Cause.QUEUE), (61, Cause.TURNING), (90, Cause.TURNING), (121, Cause.QUEUE)]
)
def test_a_robot_across_the_tunnel_is_turning(degrees, cause):
    """The cosine between heading and axis is a half at 60 degrees."""
    script = Script("single-lane", 2, STEPS)
    arrive(script, 0, X, 1)
    arrive(script, 1, X - LENGTH, 1)
    script.pose[:, 0, 2] = np.radians(degrees)
    script.meet(range(HALT, STEPS + 1), 0, 1)
    assert only(script).cause is cause


def test_across_is_measured_against_the_direction_home_not_the_map():
    """In the upright part of the bend, a robot that faces up goes along."""
    causes = []
    for heading in (0.5 * np.pi, 0.0):
        script = Script("s-bend", 2, STEPS)
        for robot, row in enumerate((6.5, 5.7)):
            script.pose[:, robot, :2] = middle(15.5, row)
            script.pose[:, robot, 2] = heading
            script.action[1:, robot] = 3
        script.meet(range(1, STEPS + 1), 0, 1)
        causes.append(found(script)[0].cause)
    assert causes == [Cause.QUEUE, Cause.TURNING]


def test_a_robot_across_before_the_tunnel_is_none():
    script = Script("single-lane", 2, STEPS)
    for robot in (0, 1):
        script.pose[:, robot] = (*middle(7, 3 + 0.7 * robot), 0.5 * np.pi)
        script.action[1:, robot] = 3
    script.meet(range(1, STEPS + 1), 0, 1)
    assert only(script).cause is Cause.QUEUE


def test_a_pellet_between_two_blocks_them():
    script = Script("single-lane", 2, STEPS)
    arrive(script, 0, X, 1)
    arrive(script, 1, X + LENGTH + 0.04, 1)
    for robot in (0, 1):
        script.press(range(HALT, STEPS + 1), robot, 9)
    clog = only(script)
    assert clog.members == (0, 1)
    assert clog.cause is Cause.PELLET
    script.laden[:, 1] = True
    assert only(script).cause is Cause.HEAD_ON, "linked by the pellet, bound in opposite directions"


@pytest.mark.parametrize(("apart", "cause"), [(0.24, Cause.QUEUE), (0.26, Cause.HEAD_ON)])
def test_robots_abreast_are_not_head_on(apart, cause):
    """A quarter of a length along the tunnel decides."""
    script = Script("paper", 2, STEPS)
    arrive(script, 0, X, 1)
    arrive(script, 1, X + apart * LENGTH, -1, Y + LENGTH)
    script.laden[:, 1] = True
    script.meet(range(HALT, STEPS + 1), 0, 1)
    assert only(script).cause is cause


def test_robots_that_have_passed_each_other_are_not_head_on():
    script = head_on()
    script.laden[:, 0], script.laden[:, 1] = True, False
    assert only(script).cause is Cause.QUEUE


def test_head_on_wants_a_link_between_the_two():
    """Three in a row: the outer two are bound for opposite ends, but only the middle one touches both."""
    script = Script("single-lane", 3, STEPS)
    for robot, load in enumerate((False, True, True)):
        arrive(script, robot, X + robot * LENGTH, 1)
        script.laden[:, robot] = load
    script.laden[:, 0], script.laden[:, 1], script.laden[:, 2] = True, False, True
    script.meet(range(HALT, STEPS + 1), 0, 1)
    assert only(script).cause is Cause.QUEUE
    script.meet(range(HALT, STEPS + 1), 1, 2)
    assert only(script).cause is Cause.HEAD_ON


def _stops(script):
    script.action[HALT + 1 :, :2] = 4


def _alone_at_the_wall(script):
    for rows in script.contacts:
        rows.clear()
    for robot in (0, 1):
        script.rub(range(HALT, STEPS + 1), robot)


def _moves_on(script):
    """Half a length in three seconds."""
    script.pose[:, :2, 0] = X + np.arange(STEPS + 1)[:, None] * (0.5 * LENGTH / HOLD + 1e-6)


def _elsewhere(script):
    script.pose[:, :2, 0] -= X - middle(4, 3)[0]


@pytest.mark.parametrize("change", [_stops, _alone_at_the_wall, _moves_on, _elsewhere])
def test_what_is_no_clog(change):
    script = head_on()
    change(script)
    assert found(script) == []


def test_the_mouth_is_a_part_of_the_tunnel_for_this():
    for column, within in ((7, True), (6, False), (19, True), (20, False)):
        script = Script("single-lane", 2, STEPS)
        for robot in (0, 1):
            script.pose[:, robot, :2] = middle(column, 3 + robot)
            script.action[1:, robot] = 3
        script.meet(range(1, STEPS + 1), 0, 1)
        assert (len(found(script)) == 1) == within


def test_k_can_be_chosen_afterwards():
    """2.5 transit times: a clog for k = 2, none for k = 3."""
    script = head_on()
    leave(script, 0, -1)
    standstills = found(script)
    assert len(clogs_among(standstills)) == 1
    assert clogs_among(standstills, 3.0) == []
    assert len(clogs_among(standstills, SHORTEST)) == 1


@pytest.mark.parametrize(("decisions", "kept", "clog"), [(13, 0, 0), (14, 1, 0), (54, 1, 0), (56, 1, 1)])
def test_a_clog_lasts_longer_than_two_transit_times(decisions, kept, clog):
    """Which are 55 decisions; from half a transit time on, 13.75 decisions, standstills are kept."""
    script = head_on()
    leave(script, 0, -1, over=HALT + decisions)
    standstills = found(script)
    assert (len(standstills), len(clogs_among(standstills))) == (kept, clog)


def test_a_passage_cuts_the_clock():
    """Somebody squeezes through while the two stand: two pieces, one after the other."""
    script = head_on("paper")
    _passes(script, HALT + 40, arena_row=4)
    first, second = found(script)
    assert (first.start, first.end, first.ending) == (HALT, HALT + 40, Ending.PASSAGE)
    assert (second.start, second.end, second.ending) == (HALT + 40, STEPS + 1, Ending.RUN_ENDED)
    assert first.members == second.members == (0, 1)
    assert clogged_decisions([first, second], STEPS) == STEPS + 1 - HALT, "no decision twice or missing"


def test_every_passage_cuts_whoever_passes_first():
    """Robot 2 comes through after robot 3 does, but has the lower number."""
    script = head_on("paper", robots=4)
    _passes(script, HALT + 60, 2, 4)
    _passes(script, HALT + 35, 3, 4)
    pieces = [(clog.start, clog.end) for clog in found(script)]
    assert pieces == [(HALT, HALT + 35), (HALT + 35, HALT + 60), (HALT + 60, STEPS + 1)]


def test_a_passage_of_another_tunnel_cuts_nothing():
    script = head_on("two-tunnels", y=middle(0, 6)[1])
    _passes(script, HALT + 40, arena_row=2)
    assert [(clog.start, clog.end) for clog in found(script)] == [(HALT, STEPS + 1)]


@pytest.mark.parametrize(("leaves", "pieces"), [(4, 1), (26, 1), (29, 2)])
def test_a_passage_that_had_begun_before_the_halt_cuts_nothing(leaves, pieces):
    """The third robot is 28 decisions in the tunnel: it may have been past the place when the two met."""
    script = head_on("paper")
    _passes(script, HALT + leaves, arena_row=4)
    assert len(found(script)) == pieces
    assert found(script)[0].start == HALT


def test_the_foremost_cause_of_the_first_three_seconds_counts():
    """A queue is recognised; the one that it waits for, bound for the other end, has its part 1 s later."""
    script = Script("single-lane", 3, STEPS)
    for robot, x in ((0, X + 0.2), (1, X + 0.1)):
        arrive(script, robot, x, -1)
        script.laden[:, robot] = True
    script.meet(range(HALT + 1, STEPS + 1), 0, 1)
    assert found(script)[0].cause is Cause.QUEUE
    arrive(script, 2, X, 1, halt=HALT + 3)
    script.meet(range(HALT + 4, STEPS + 1), 1, 2)
    (clog,) = found(script)
    assert (clog.start, clog.members, clog.cause) == (HALT, (0, 1, 2), Cause.HEAD_ON)
    late = Script("single-lane", 3, STEPS)
    late.pose[:], late.laden[:], late.action[:] = script.pose, script.laden, script.action
    late.meet(range(HALT + 1, STEPS + 1), 0, 1)
    late.meet(range(HALT + HOLD + 12, STEPS + 1), 1, 2)
    assert found(late)[0].cause is Cause.QUEUE


def test_a_passage_in_a_pause_ends_the_stay():
    """The two part for a moment, one comes through, and they meet again: nothing stood all the time."""
    script = head_on("paper")
    let_go(script, OVER - HOLD + 1, OVER + 5)
    assert [(clog.start, clog.end) for clog in found(script)] == [(HALT, STEPS + 1)]
    _passes(script, OVER + 2, arena_row=4)
    first, second = found(script)
    assert (first.start, first.end, first.ending) == (HALT, OVER, Ending.LET_GO)
    assert (second.start, second.end) == (OVER + 2, STEPS + 1)


@pytest.mark.parametrize(("pause", "one"), [(HOLD - 1, True), (HOLD, False)])
def test_a_pause_shorter_than_three_seconds_does_not_part_a_stay(pause, one):
    """`pause` decisions without a group."""
    script = head_on()
    let_go(script, OVER - HOLD + 1, OVER + pause)
    spans = [(clog.start, clog.end) for clog in found(script)]
    if one:
        assert spans == [(HALT, STEPS + 1)]
    else:
        assert spans == [(HALT, OVER), (OVER + pause - HOLD, STEPS + 1)]


def test_two_at_once_in_two_tunnels():
    script = head_on("two-tunnels", robots=5, y=middle(0, 6)[1])
    low = middle(0, 2)[1]
    for robot, heading in ((2, 1), (3, -1)):
        arrive(script, robot, X + (robot - 2) * LENGTH, heading, low, halt=HALT + 12)
    script.laden[:, 3] = True
    script.meet(range(HALT + 12, STEPS + 1), 2, 3)
    leave(script, 2, -1)
    first, second = found(script)
    assert (first.tunnel, first.members, first.start, first.end) == (1, (0, 1), HALT, STEPS + 1)
    assert (second.tunnel, second.members, second.start, second.end) == (0, (2, 3), HALT + 12, OVER)
    assert clogged_decisions([first, second], STEPS) == STEPS + 1 - HALT, "after a decision it clogs or not"


def test_a_group_that_grows_is_the_same():
    script = head_on()
    arrive(script, 2, X - LENGTH, 1, halt=HALT + 30)
    script.meet(range(HALT + 30, STEPS + 1), 0, 2)
    clog = only(script)
    assert (clog.start, clog.end, clog.members) == (HALT, STEPS + 1, (0, 1, 2))


def test_a_group_that_shrinks_is_the_same():
    script = head_on(robots=4)
    arrive(script, 2, X - LENGTH, 1)
    script.meet(range(HALT, STEPS + 1), 0, 2)
    leave(script, 2, -1)
    clog = only(script)
    assert (clog.start, clog.end, clog.members) == (HALT, STEPS + 1, (0, 1, 2))


def twice(robots: int = 5) -> Script:
    """Robots 0 and 1 stand from HALT on, 2 and 3 further in from HALT + 10 on; robot 4 is free."""
    script = Script("single-lane", robots, STEPS)
    later = HALT + 10
    places = ((X, HALT), (X + LENGTH, HALT), (X + 3 * LENGTH, later), (X + 4 * LENGTH, later))
    for robot, (x, halt) in enumerate(places):
        arrive(script, robot, x, 1, halt=halt)
    script.meet(range(HALT, STEPS + 1), 0, 1)
    script.meet(range(later, STEPS + 1), 2, 3)
    return script


def test_groups_that_grow_together_go_on_as_the_oldest():
    script = twice()
    first, second = found(script)
    assert (first.members, second.members) == ((0, 1), (2, 3))
    assert (first.start, second.start) == (HALT, HALT + 10)
    script.meet([HALT + 50], 1, 2)
    clog = only(script)
    assert (clog.start, clog.end, clog.members) == (HALT, STEPS + 1, (0, 1, 2, 3))


def test_a_group_that_falls_in_two_is_one_stay():
    """Linked once, for three seconds; apart from then on, but never gone."""
    script = twice()
    script.meet([HALT + 50], 1, 2)
    leave(script, 1, -1)
    clog = only(script)
    assert (clog.start, clog.end, clog.members) == (HALT, STEPS + 1, (0, 1, 2, 3)), "2 and 3 stand on"


def test_a_part_of_one_stay_that_grows_into_an_older_one_takes_the_rest_with_it():
    """Stay A: 3 and 4. Stay B: 0, 1 and 2, from later on. Then of B, 0 and 1 stay together, and 2 joins A."""
    script = Script("single-lane", 5, STEPS)
    for robot in range(5):
        arrive(script, robot, X + robot * LENGTH, 1, halt=HALT if robot >= 3 else HALT + 10)
    script.meet(range(HALT, STEPS + 1), 3, 4)
    script.meet(range(HALT + 10, STEPS + 1), 0, 1)
    # The link of 1 and 2 holds until HALT + 59; then there is one of 2 and 3 at once.
    script.meet(range(HALT + 10, HALT + 51), 1, 2)
    script.meet(range(HALT + 60, STEPS + 1), 2, 3)
    leave(script, 4, 1, over=HALT + 90)
    clog = only(script)
    assert (clog.start, clog.end, clog.members) == (HALT, STEPS + 1, (0, 1, 2, 3, 4))


def test_who_left_a_group_long_ago_is_a_stranger():
    """Robot 2 leaves; much later, in a pause of the others, it stands with robot 3 somewhere else."""
    script = head_on(robots=4)
    arrive(script, 2, X - LENGTH, 1)
    script.meet(range(HALT, HALT + 20), 0, 2)
    leave(script, 2, -1, over=HALT + 20, distance=8 * TOP)
    x, y = script.pose[HALT + 40, 2, :2]
    script.pose[:, 3, :2] = x - LENGTH, y
    script.action[1:, 2:] = 3
    # The two of them meet in the second decision of the others' pause, which lasts for five.
    script.meet(range(OVER + 1, STEPS + 1), 2, 3)
    let_go(script, OVER - HOLD + 1, OVER + 5)
    spans = {clog.members: (clog.start, clog.end) for clog in found(script)}
    assert spans == {(0, 1, 2): (HALT, STEPS + 1), (2, 3): (OVER + 1 - HOLD, STEPS + 1)}


def test_who_has_just_left_a_group_still_belongs_to_it():
    """The group goes on without robot 2, which within three seconds is in another with robot 3."""
    script = head_on(robots=4)
    for robot in (2, 3):
        arrive(script, robot, X - (robot - 1) * LENGTH, 1)
    script.meet(range(HALT, HALT + 41), 0, 2)
    # 2 is linked to 0 until HALT + 49, and to 3 from HALT + 52 on.
    script.meet(range(HALT + 52, STEPS + 1), 2, 3)
    clog = only(script)
    assert (clog.start, clog.end, clog.members) == (HALT, STEPS + 1, (0, 1, 2, 3))


def test_a_run_that_ends_in_a_pause_ends_the_clog_where_it_was_last_seen():
    script = head_on(steps=OVER + 4)
    leave(script, 0, -1)
    clog = only(script)
    assert (clog.end, clog.ending) == (OVER, Ending.RUN_ENDED)


def test_nobody_clogs_in_the_first_three_seconds_but_the_start_may_be_the_first_decision():
    script = Script("single-lane", 2, 60)
    for robot in (0, 1):
        script.pose[:, robot, :2] = X + robot * LENGTH, Y
        script.action[1:, robot] = 3
    script.meet(range(1, 61), 0, 1)
    clog = only(script)
    assert (clog.start, clog.end) == (0, 61)
    assert clogged_decisions([clog], 60) == 60


def _same_as_plain(run):
    standstills = run.watch().standstills
    expected = PlainClogs(PlainRun(run), HOLD, SHORTEST).found
    read = [clog._asdict() | {"cause": clog.cause.name, "ending": clog.ending.name} for clog in standstills]
    exact = ("tunnel", "start", "end", "members", "cause", "ending")
    assert [[clog[key] for key in exact] for clog in read] == [
        [clog[key] for key in exact] for clog in expected
    ]
    for clog, other in zip(read, expected, strict=True):
        assert clog["place"] == pytest.approx(other["place"])
        assert clog["distance"] == pytest.approx(other["distance"])
        assert clog["transits"] == pytest.approx(other["transits"])
    return standstills


@pytest.mark.parametrize("name", REAL)
def test_real_runs_are_read_as_the_plain_reading_does(name):
    _same_as_plain(real(name))


def test_real_runs_have_something_to_read():
    clogs = [clog for name in REAL for clog in real(name).watch().standstills]
    assert len(clogs) > 10
    assert {clog.cause for clog in clogs} >= {Cause.HEAD_ON, Cause.PELLET, Cause.QUEUE}
    assert len({clog.ending for clog in clogs}) >= 4


@given(runs())
def test_any_run_is_read_as_the_plain_reading_does(run):
    _same_as_plain(run)


@settings(max_examples=150)
@given(crowds())
def test_any_crowd_is_read_as_the_plain_reading_does(run):
    _same_as_plain(run)
