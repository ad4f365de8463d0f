"""Comparisons: whose numbers they are, what is normalised by what, and what is left out and said so."""

import pytest

from robosim.errors import InputError
from robosim.experiments.comparison import compare
from robosim.experiments.runs import Run, Task
from robosim.experiments.statistics import estimate, interquartile_mean, probability_of_improvement

TWO, FOUR = (Task("paper", "grid", 300, robots) for robots in (2, 4))


def runs(system, scores, task=TWO, metric="pellets", episodes=2):
    """Return a run a score; its episodes lie one above and one below it."""
    spread = [1.0, -1.0] if episodes == 2 else [0.0] * episodes
    return [
        Run(
            f"{system}-{seed}",
            system,
            task,
            seed,
            {metric: tuple(score + one for one in spread)},
            system=system,
        )
        for seed, score in enumerate(scores)
    ]


LANES, OURS, WORSE = [10.0, 12.0, 11.0], [9.0, 13.0, 8.0, 7.0], [3.0, 4.0]
GIVEN = runs("lanes", LANES) + runs("ours", OURS) + runs("worse", WORSE)


def rows(comparison, number=0):
    return {row.system: row for row in comparison.tables[number].rows}


def test_a_task_is_named_by_what_it_is():
    assert str(TWO) == "paper (grid world), 2 robots, episodes of 300 decisions"
    assert str(Task("paper", "physics", 5000, 1)) == "paper, 1 robot, episodes of 5000 decisions"


def test_a_table_is_the_statistics_of_the_means_of_runs():
    comparison = compare(GIVEN)
    found = rows(comparison)
    assert list(found) == ["lanes", "ours", "worse"]
    assert found["ours"].iqm == estimate(interquartile_mean, [9.0, 13.0, 8.0, 7.0])
    assert found["ours"].iqm.value == 8.5
    assert found["ours"].scores == OURS
    assert (found["ours"].seeds, found["ours"].episodes) == ([0, 1, 2, 3], 8)
    assert found["ours"].normalised.value == 8.5 / 11.0
    assert found["ours"].normalised.low == found["ours"].iqm.low / 11.0
    assert found["ours"].improvement == probability_of_improvement([OURS], [LANES])
    assert found["ours"].improvement.value == 3 / 12
    assert found["lanes"].normalised.value == 1.0
    assert found["lanes"].improvement is None
    assert comparison.tables[0].baseline == "lanes"
    assert comparison.overall == []


def test_too_few_seeds_have_no_interval_and_that_is_said():
    comparison = compare(GIVEN)
    assert rows(comparison)["worse"].iqm.low is None
    assert comparison.notes == [
        "Fewer than 3 seeds say too little for an interval: their scores are printed."
    ]
    assert compare(runs("lanes", LANES) + runs("ours", OURS)).notes == []


def test_without_the_reference_the_best_of_each_task_is_the_baseline():
    given = (
        runs("a", [5.0] * 3) + runs("b", [6.0] * 3) + runs("a", [9.0] * 3, FOUR) + runs("b", [6.0] * 3, FOUR)
    )
    comparison = compare(given)
    assert [table.baseline for table in comparison.tables] == ["b", "a"]
    assert [one.system for one in comparison.overall] == ["a", "b"]
    assert {one.system: one.iqm.value for one in comparison.overall} == {
        "a": pytest.approx((5 / 6 + 1) / 2),
        "b": pytest.approx((1 + 6 / 9) / 2),
    }
    assert {one.system: one.improvement.value for one in comparison.overall} == {"a": 0.0, "b": 0.0}


def test_a_system_that_is_the_baseline_in_every_task_is_better_than_nobody():
    given = (
        runs("a", [1.0] * 3) + runs("b", [9.0] * 3) + runs("a", [1.0] * 3, FOUR) + runs("b", [9.0] * 3, FOUR)
    )
    assert [one.improvement for one in compare(given).overall if one.system == "b"] == [None]


def test_over_all_tasks_the_best_comes_first():
    given = [
        *runs("a", [1.0] * 3),
        *runs("b", [9.0] * 3),
        *runs("b", [9.0] * 3, FOUR),
        *runs("a", [1.0] * 3, FOUR),
    ]
    for order in (given, given[::-1]):
        assert [one.system for one in compare(order).overall] == ["b", "a"]


def test_over_all_tasks_are_those_that_have_runs_of_all():
    given = [*GIVEN, *runs("lanes", [20.0, 22.0, 21.0], FOUR), *runs("ours", [21.0] * 3, FOUR)]
    comparison = compare(given)
    assert [one.system for one in comparison.overall] == ["lanes", "ours"]
    ours = comparison.overall[1]
    assert comparison.normalised["ours"] == [[score / 11.0 for score in OURS], [1.0] * 3]
    assert ours.mean.value == pytest.approx((9.25 / 11.0 + 1.0) / 2)
    assert ours.optimality_gap.value == pytest.approx((2 + 0 + 3 + 4) / 11 / 4 / 2)
    # In the second task: above 20, equal to 21, below 22.
    assert ours.improvement.value == pytest.approx((3 / 12 + 0.5) / 2)
    assert comparison.notes[0] == "Not in the figures over all tasks, since they lack runs of some: worse."


def test_fewer_touches_are_better():
    given = runs("lanes", [10.0] * 3, metric="touches") + runs(
        "ours", [2.0, 30.0, 4.0, 5.0], metric="touches"
    )
    comparison = compare(given, "touches")
    assert list(rows(comparison)) == ["ours", "lanes"]
    assert rows(comparison)["ours"].improvement.value == 0.75


def test_runs_without_the_figure_are_left_out_and_that_is_said():
    comparison = compare([*GIVEN, *runs("blind", [1.0, 2.0], metric="gini")])
    assert "blind" not in rows(comparison)
    assert comparison.notes[0] == "Left out are runs without a figure pellets: 2 of blind."
    with pytest.raises(InputError) as caught:
        compare(GIVEN, "pellet")
    assert str(caught.value) == '--metric: no run has a figure "pellet": did you mean pellets?'


def test_a_baseline_may_be_a_technique_but_of_one_system(capsys):
    given = runs("lanes", LANES) + runs("ours", OURS)
    assert compare(given, baseline="ours").tables[0].baseline == "ours"
    with pytest.raises(InputError) as caught:
        compare(given, baseline="lane")
    assert str(caught.value) == '--baseline: no run is of "lane": did you mean lanes?'
    several = [
        Run(str(seed), "ours", TWO, seed, {"pellets": (1.0,)}, system=f"ours gamma={gamma}")
        for seed, gamma in enumerate((0.9, 0.99))
    ]
    with pytest.raises(InputError) as caught:
        compare(several, baseline="ours")
    assert str(caught.value) == (
        '--baseline is "ours", but there are ours gamma=0.9 and ours gamma=0.99: name one of them.'
    )
    assert compare(several, baseline="ours gamma=0.9").tables[0].baseline == "ours gamma=0.9"


def test_where_the_baseline_has_no_runs_or_no_score_nothing_is_normalised():
    comparison = compare([*GIVEN, *runs("ours", OURS, FOUR)])
    assert comparison.tables[1].baseline is None
    assert rows(comparison, 1)["ours"].normalised is None
    assert comparison.notes[0] == (f"{FOUR}: no runs of lanes here, so nothing is normalised.")
    comparison = compare(runs("lanes", [0.0] * 3, episodes=1) + runs("ours", OURS))
    assert rows(comparison)["ours"].normalised is None
    assert rows(comparison)["ours"].improvement.value == 1.0
    assert comparison.notes[0] == (f"{TWO}: lanes has no score above 0, so nothing is normalised.")
