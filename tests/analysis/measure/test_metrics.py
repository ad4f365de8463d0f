"""Every metric of three runs made by hand, worked out beside it; and that none is ever NaN."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from robosim.analysis.clogs.clog import Cause
from robosim.analysis.measure.metrics import (
    METRICS,
    NotDefined,
    Summary,
    clog_durations,
    clogs,
    shown,
    summarise,
)
from robosim.analysis.measure.monitor import EpisodeMonitor
from robosim.analysis.measure.tails import fit_power_law
from robosim.arena import load_arena
from robosim.discretise.modes import Mode
from tests.analysis.handmade import LENGTH, REAL, Script, crowds, middle, real, runs, without_tunnel

NAMES = [metric.name for metric in METRICS]
LANE = 3.5 * 0.15
OTHER_LANE = 4.5 * 0.15


def to_and_fro() -> Script:
    """Robot 0 goes through the tunnel and back five times, 90 decisions each; robot 1 stands in the home.

    Along x = 0.925 m + 5 cm a decision it is in the tunnel, 1.2 to 2.85 m, after decisions 6 to 38 and 52
    to 84 of each round: 33 steps of 5 cm in 1.65 m. It turns, and takes its pellet, at 45.
    """
    script = Script("paper", 2, 450)
    for begin in range(0, 450, 90):
        script.drive(0, [(begin, 0.925, LANE), (begin + 45, 3.175, LANE), (begin + 90, 0.925, LANE)])
        script.laden[begin + 45 : begin + 90, 0] = True
        script.delivered[begin + 90 :, 0] += 1
        modes = [
            (Mode.EXIT_HOME, 10), (Mode.GOING_TO_DIG, 30), (Mode.DIGGING, 5), (Mode.EXIT_DIGGING, 5),
            (Mode.GOING_HOME, 29), (Mode.DUMPING, 6), (Mode.COLLISION, 5),
        ]  # fmt: skip
        script.mode[begin + 1 : begin + 91, 0] = np.repeat(*zip(*modes, strict=True))
        script.action[begin + 1 : begin + 10, 0] = 4
    script.energy[:, 0] = 0.02 * np.arange(451)
    # Decisions 10 and 11 are one touch; 13 begins another, since a decision without one lies between.
    script.meet([10, 11, 13], 0, 1, impulse=0.01)
    script.rub([20], 0)
    script.rub([100], 1)
    script.press([43, 44, 45], 0, 3)
    return script


# Windows of 100 decisions: inside after 33 + 33 + 5, 28 + 33 + 15, 18 + 33 + 25 and 8 + 33 + 33 of them.
INSIDE = np.array([71, 76, 76, 74])

TO_AND_FRO = {
    "pellets": 5.0,
    "pellets in 1000 decisions": 1000 * 5 / 450,
    "Gini coefficient of the workload": 0.5,
    "active fraction": 0.5,
    "decisions to stop": (450 + 5 * 9) / 900,
    "trip time": 27.0,
    "- of it Exit-home": 10 / 90,
    "- of it Going-to-dig": 30 / 90,
    "- of it Digging": 5 / 90,
    "- of it Exit-digging": 5 / 90,
    "- of it Going-home": 29 / 90,
    "- of it Dumping": 6 / 90,
    "- of it Collision": 5 / 90,
    "touches of robots per trip": 2 * 2 / 5,
    "closest approach of two robots": NotDefined("distances were not metered"),
    "touches of walls per trip": 2 / 5,
    "touches of pellets per trip": 1 / 5,
    "impulse between robots per trip": 3 * 0.01 * 12 * 2 / 5,
    "reversals per trip": 0.0,
    "wheel energy per pellet": 0.02 * 450 / 5,
    "passages": 10 / 135 * 3600,
    "tunnel density": INSIDE.mean() / 100 / 1.65,
    # At 5 cm in 0.3 s, always toward the goal: q = k v.
    "tunnel flow": INSIDE.mean() / 100 / 1.65 * 0.05 / 0.3,
    "robots in the tunnels, mean": 66 / 90,
    "robots in the tunnels, most": 1.0,
    "one robot alone in the tunnels": 1.0,
    "bidirectional traffic": 0.0,
    "lane segregation": 0.0,
    # Out of it after decisions 39 and 85 of each round: five lapses of 46 decisions, four of 44.
    "lapse between passages, median": 46 * 0.3,
    "lapse tail exponent": NotDefined("a tail wants 50 lapses and more, not all the same: there are 9"),
    "clogs": 0.0,
    "time clogged": 0.0,
    "clog duration, mean": NotDefined("no clogs"),
    "clog duration, longest": NotDefined("no clogs"),
}


def both_ways() -> Script:
    """Robot 0 out in one lane and robot 1 home in the other, then robot 1 half in and back out again.

    At 5 cm a decision from 0.975 m on, a robot is inside after decisions 5 to 37 of its run.
    """
    script = Script("paper", 2, 200)
    script.drive(0, [(0, 0.975, LANE), (42, 3.075, LANE)])
    script.pose[:10, 1, :2] = 3.075, OTHER_LANE
    script.drive(1, [(10, 3.075, OTHER_LANE), (52, 0.975, OTHER_LANE)])
    script.laden[:60, 1] = True
    script.delivered[60:, 1] = 1
    script.drive(1, [(60, 0.975, OTHER_LANE), (100, 0.975, LANE), (112, 1.575, LANE), (124, 0.975, LANE)])
    return script


BOTH_WAYS = {
    "pellets": 1.0,
    "Gini coefficient of the workload": 0.5,
    "active fraction": NotDefined("the run is shorter than 120 s"),
    "trip time": 18.0,
    "reversals per trip": 1.0,
    "passages": 120.0,
    # Inside for 33 decisions each; then, in the second window, for 15, of which 8 lead in and 7 back.
    "tunnel density": (66 + 15) / 2 / 100 / 1.65,
    "tunnel flow": (66 + 8 - 7) / 2 * 0.05 / 30 / 1.65,
    # Decisions 5 to 37, 15 to 47, and 105 to 119.
    "robots in the tunnels, mean": (33 + 33 + 15) / 200,
    "robots in the tunnels, most": 2.0,
    "one robot alone in the tunnels": (10 + 10 + 15) / (10 + 23 + 10 + 15),
    "bidirectional traffic": 23 / (10 + 23 + 10 + 15),
    "lane segregation": 1.0,
    # Out after decisions 38 and 48.
    "lapse between passages, median": 3.0,
    "wheel energy per pellet": 0.0,
}


def stuck() -> Script:
    """Two that press on each other with one break, and never deliver."""
    script = Script("single-lane", 2, 200)
    for robot in (0, 1):
        script.pose[:, robot, :2] = 1.9 + robot * LENGTH, LANE
        script.action[1:, robot] = 3
    script.laden[:, 1] = True
    script.meet(range(1, 71), 0, 1)
    script.meet(range(110, 201), 0, 1)
    return script


NO_TRIPS = NotDefined("no trips")
STUCK = {
    "pellets": 0.0,
    "pellets in 1000 decisions": 0.0,
    "Gini coefficient of the workload": NotDefined("no pellets were delivered"),
    "decisions to stop": 0.0,
    "trip time": NO_TRIPS,
    "- of it Collision": NO_TRIPS,
    "touches of robots per trip": NO_TRIPS,
    "impulse between robots per trip": NO_TRIPS,
    "reversals per trip": NO_TRIPS,
    "wheel energy per pellet": NotDefined("no pellets were delivered"),
    "passages": 0.0,
    "tunnel density": 2 / 1.65,
    "tunnel flow": 0.0,
    "bidirectional traffic": 0.0,  # who stands is no traffic
    "lane segregation": NotDefined("not both laden and unladen robots moved along a tunnel"),
    "lapse between passages, median": NotDefined("fewer than two passages of a tunnel"),
    # The touch of decision 70 holds until 79. The next is recognised at once and begins HOLD before, at 100.
    "clogs": 2.0,
    "time clogged": (79 + 101) / 200,
    "clog duration, mean": (80 + 101) / 2 * 0.3,
    "clog duration, longest": 101 * 0.3,
}


def metrics_of(script: Script) -> dict[str, float | NotDefined]:
    return {summary.metric.name: summary.values[0] for summary in summarise([script.watch()])}


@pytest.mark.parametrize(
    ("script", "known"), [(to_and_fro, TO_AND_FRO), (both_ways, BOTH_WAYS), (stuck, STUCK)]
)
def test_metrics_are_those_worked_out_by_hand(script, known):
    found = metrics_of(script())
    for name, value in known.items():
        expected = pytest.approx(value, abs=1e-12) if isinstance(value, float) else value
        assert found[name] == expected, name


def test_every_metric_is_worked_out_somewhere():
    assert [name for name in NAMES if name not in TO_AND_FRO] == []
    assert len(set(NAMES)) == len(NAMES)


def test_every_figure_has_a_definition():
    for metric in METRICS:
        assert (metric.compute.__doc__ or "").startswith("Return ")
        assert not metric.definition.startswith("Return")
        assert len(metric.definition) > 15
        assert metric.definition.endswith((".", ")"))
        assert "  " not in metric.definition


def test_the_exponent_is_that_of_the_lapses():
    """A robot gets through whenever we want: one decision inside at the home end, then beyond the other."""
    rng = np.random.default_rng(0)
    lapses = np.ceil(3.0 * rng.random(80) ** (-1.0 / 1.5)).astype(int) + 2
    ends = np.cumsum(lapses) + 5
    script = Script("single-lane", 1, int(ends[-1]) + 2)
    script.pose[..., :2] = middle(6, 3)
    script.pose[ends - 1, 0, :2] = middle(8, 3)
    script.pose[ends, 0, :2] = middle(20, 3)
    expected = fit_power_law(np.diff(ends) * 0.3)
    assert metrics_of(script)["lapse tail exponent"] == expected.alpha
    assert metrics_of(script)["lapse between passages, median"] == pytest.approx(
        np.median(np.diff(ends)) * 0.3
    )


def test_two_tunnels_share_the_means():
    """One robot in one of two tunnels: half the density of each, but one robot in the tunnels."""
    script = Script("two-tunnels", 1, 100)
    script.pose[..., :2] = middle(12, 6)
    found = metrics_of(script)
    assert found["tunnel density"] == pytest.approx(0.5 / 1.65)
    assert found["robots in the tunnels, mean"] == 1.0


def test_clogs_can_be_counted_with_another_k():
    """24 and 30.3 s are 2.9 and 3.7 transit times."""
    episode = stuck().watch()
    assert [len(clogs(episode, k)) for k in (1.0, 2.0, 3.0, 4.0)] == [2, 2, 1, 0]
    assert clog_durations(episode, 3.0) == pytest.approx([30.3])
    assert clogs(episode)[0].cause is Cause.HEAD_ON


def sound(episode) -> None:
    for metric in METRICS:
        figure = metric.compute(episode)
        if isinstance(figure, NotDefined):
            assert figure.reason
        else:
            assert isinstance(figure, float), metric.name
            assert math.isfinite(figure), metric.name
        assert shown(figure)


@given(runs())
def test_every_figure_of_any_run_is_finite_or_says_why_not(run):
    with np.errstate(all="raise"):
        sound(run.watch())


@given(crowds())
def test_every_figure_of_any_crowd_is_finite_or_says_why_not(run):
    with np.errstate(all="raise"):
        sound(run.watch())


@pytest.mark.parametrize("decisions", [0, 1, 2])
@pytest.mark.parametrize("robots", [1, 3])
@pytest.mark.parametrize("arena", ["paper", "two-tunnels", None])
def test_the_shortest_runs_have_metrics_too(arena, robots, decisions):
    script = Script(arena or without_tunnel(), robots, decisions)
    episode = script.watch()
    assert episode.decisions == decisions
    assert episode.seconds == pytest.approx(0.3 * decisions)
    sound(episode)
    found = metrics_of(script)
    assert found["pellets"] == 0.0
    assert isinstance(found["decisions to stop"], NotDefined) == (decisions == 0)
    if arena is None:
        for name in NAMES[NAMES.index("passages") :]:
            assert found[name] == NotDefined("the arena has no tunnel"), name


def test_a_monitor_that_saw_nothing_has_metrics_too():
    episode = EpisodeMonitor(load_arena("paper"), 2).finish()
    assert episode.decisions == 0
    sound(episode)


def test_robots_that_never_move_have_metrics_too():
    script = Script("two-tunnels", 3, 450)
    sound(script.watch())
    assert metrics_of(script)["active fraction"] == 0.0
    assert metrics_of(script)["one robot alone in the tunnels"] == NotDefined("no robot was in a tunnel")


@pytest.mark.parametrize("name", REAL)
def test_real_runs_cut_short_have_metrics_too(name):
    run = real(name)
    for length in (1, 2, 3, 12, 101):
        monitor = EpisodeMonitor(run.arena, run.robots)
        for frame in run.frames[:length]:
            monitor.add(frame)
        sound(monitor.finish())
    sound(run.watch())


def test_an_arena_without_pellets_has_metrics_too():
    arena = load_arena("single-lane")
    script = Script(replace(arena, pellets=replace(arena.pellets, count=0)), 2, 120)
    script.pose[..., :2], script.action[1:] = middle(12, 3), 3
    script.meet(range(1, 121), 0, 1)
    with np.errstate(all="raise"):
        sound(script.watch())
    assert metrics_of(script)["clogs"] == 1.0


def test_one_robot_has_nobody_to_share_with():
    script = Script("paper", 1, 100)
    script.delivered[50:] = 1
    assert metrics_of(script)["Gini coefficient of the workload"] == NotDefined(
        "one robot has nobody to share with"
    )


def test_a_summary_is_of_the_episodes_that_have_the_figure():
    none = NotDefined("no trips")
    summary = Summary(METRICS[0], (none, 2.0, 5.0))
    assert summary.mean == 3.5
    assert summary.std == pytest.approx(math.sqrt(4.5))
    assert Summary(METRICS[0], (2.0,)).std == NotDefined("fewer than two episodes")
    assert Summary(METRICS[0], (none, none)).mean == none
    assert Summary(METRICS[0], ()).mean == NotDefined("no episodes")


def test_summaries_are_in_the_order_of_the_metrics():
    episodes = [stuck().watch(), both_ways().watch()]
    summaries = summarise(episodes)
    assert [summary.metric for summary in summaries] == list(METRICS)
    assert summaries[0].values == (0.0, 1.0)


def test_metrics_are_shown_with_four_digits():
    assert shown(1234.5678) == "1235"
    assert shown(0.00012345678) == "0.0001235"
    assert shown(NotDefined("no trips")) == "not defined: no trips"
    with pytest.raises(ValueError, match="finite"):
        shown(math.nan)
