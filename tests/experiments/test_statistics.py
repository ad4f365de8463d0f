"""Statistics of runs: values worked out by hand, what must always hold, and those of rliable."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import trim_mean

from robosim.errors import InputError
from robosim.experiments.statistics import (
    Estimate,
    band,
    estimate,
    interquartile_mean,
    mean,
    median,
    optimality_gap,
    performance_profile,
    point,
    probability_of_improvement,
)

SCORES = st.floats(-1e3, 1e3, allow_subnormal=False)
MATRICES = st.tuples(st.integers(1, 7), st.integers(1, 4)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=SCORES)
)
FEW = 200
"""Resamples where only what must hold for any number of them is checked."""

# What rliable 1.2.0 (arch 7.2.0) says of the scores in `test_rliable_says_the_same`: estimates, then bounds
# of 95 % intervals by 20,000 resamples after np.random.seed(0). It was asked by
#     from rliable import library, metrics
#     library.get_interval_estimates(
#         {"A": A}, lambda s: np.array([metrics.aggregate_iqm(s), ...]), reps=20000)
#     library.get_interval_estimates({"AB": (A, B)}, lambda x, y: np.array(
#         [metrics.probability_of_improvement(x, y)]), reps=5000)
#     library.create_performance_profile({"A": A}, np.array([0.0, 10.0, 20.0, 30.0]), reps=20000)
# with metrics.aggregate_iqm, aggregate_mean, aggregate_median, and aggregate_optimality_gap with gamma 30.
RLIABLE = {
    "A": [
        [15.583333333333334, 16.583333333333332, 18.5, 14.5],
        [9.333333333333334, 12.041666666666666, 10.125, 10.625],
        [21.666666666666668, 21.166666666666668, 23.875, 18.458333333333336],
    ],
    "B": [
        [21.2, 22.11111111111111, 23.5, 10.38888888888889],
        [14.1, 16.944444444444446, 15.666666666666666, 6.555555555555557],
        [29.0, 27.38888888888889, 29.833333333333332, 14.38888888888889],
    ],
    "first task of A": [
        [8.0, 10.875, 10.875, 19.125],
        [4.5, 6.0, 6.0, 13.25],
        [17.0, 16.75, 16.75, 24.0],
    ],
}
RLIABLE_IMPROVEMENT = (0.38541667, 0.22569444444444442, 0.5486111111111112)
RLIABLE_PROFILE = [
    [0.91666667, 0.58333333, 0.41666667, 0.125],
    [0.7916666666666666, 0.375, 0.25, 0.0],
    [1.0, 0.75, 0.5833333333333334, 0.25],
]


def rliable_scores():
    rng = np.random.RandomState(7)
    a = rng.randint(0, 40, size=(8, 3)).astype(float)
    b = rng.randint(5, 45, size=(6, 3)).astype(float)
    return {"A": a, "B": b, "first task of A": a[:, :1]}


@pytest.mark.parametrize("name", RLIABLE)
def test_rliable_says_the_same(name):
    def gap_to_30(tasks, draws):
        return 30.0 * optimality_gap([scores / 30.0 for scores in tasks], draws)

    scores = rliable_scores()[name]
    ours = [estimate(one, scores, resamples=20_000) for one in (interquartile_mean, mean, median, gap_to_30)]
    values, lows, highs = RLIABLE[name]
    assert [one.value for one in ours] == pytest.approx(values, abs=1e-12)
    # Both draw at random; scores span 45, and their steps are up to 1/6.
    assert [one.low for one in ours] == pytest.approx(lows, abs=0.4)
    assert [one.high for one in ours] == pytest.approx(highs, abs=0.4)


def test_rliable_says_the_same_of_two_systems_and_of_profiles():
    scores = rliable_scores()
    ours = probability_of_improvement(scores["A"], scores["B"])
    assert (ours.value, ours.low, ours.high) == (
        pytest.approx(RLIABLE_IMPROVEMENT[0], abs=1e-8),
        pytest.approx(RLIABLE_IMPROVEMENT[1], abs=0.02),
        pytest.approx(RLIABLE_IMPROVEMENT[2], abs=0.02),
    )
    profile = performance_profile(scores["A"], [0.0, 10.0, 20.0, 30.0])
    assert profile.value == pytest.approx(RLIABLE_PROFILE[0], abs=1e-8)
    # A step is one run of 24.
    assert profile.low == pytest.approx(RLIABLE_PROFILE[1], abs=1 / 24 + 1e-9)
    assert profile.high == pytest.approx(RLIABLE_PROFILE[2], abs=1 / 24 + 1e-9)


def test_the_interquartile_mean_is_that_of_the_middle_half():
    # Of eight, two go on either side: (3 + 4 + 5 + 9) / 4.
    assert point(interquartile_mean, np.array([100.0, 3, 1, 5, 9, 4, 2, 50])) == 21 / 4
    # Of two tasks together as well: the same eight.
    assert point(interquartile_mean, np.array([[100.0, 3], [1, 5], [9, 4], [2, 50]])) == 21 / 4
    # Of six, one: 6 / 4 is not whole. Of three, none.
    assert point(interquartile_mean, np.array([0.0, 1, 2, 3, 4, 99])) == 10 / 4
    assert point(interquartile_mean, np.array([0.0, 1, 5])) == 2.0


def test_means_medians_and_gaps_are_over_tasks():
    scores = np.array([[0.0, 1.0, 0.5], [1.0, 3.0, 0.5]])  # task means 0.5, 2, 0.5
    assert point(mean, scores) == 1.0
    assert point(median, scores) == 0.5
    # What lies above 1 counts as 1: (0.5 + 1 + 0.5) / 3 away from 1.
    assert point(optimality_gap, scores) == pytest.approx(1 / 3)
    # Tasks may have unequal numbers of runs; each counts as much as another.
    assert point(mean, [[1.0], [2.0, 4.0, 6.0]]) == 2.5


def test_equal_scores_count_half_in_the_probability_of_improvement():
    # Of 1 > 1, 1 > 2, 3 > 1, 3 > 2 two hold, and one is a tie.
    assert probability_of_improvement(np.array([1.0, 3.0]), np.array([1.0, 2.0])).value == 2.5 / 4
    # Two tasks: won whole, lost whole.
    won = probability_of_improvement([[5.0, 6.0], [0.0]], [[1.0], [2.0, 3.0]])
    assert won == Estimate(0.5, None, None)


def test_a_profile_is_the_share_of_runs_above():
    profile = performance_profile(np.array([0.0, 0.5, 0.5, 1.0]), [0.0, 0.25, 0.5, 1.0])
    assert profile.value.tolist() == [0.75, 0.75, 0.25, 0.0]


def test_the_interval_is_that_of_all_resamples_drawn_one_by_one():
    """A slow reference: draw runs within each task, and take the interquartile mean of what was drawn."""
    rng = np.random.default_rng(3)
    scores = rng.normal(10.0, 3.0, (6, 2))
    drawn = [
        trim_mean(np.stack([task[rng.integers(6, size=6)] for task in scores.T]), 0.25, axis=None)
        for _ in range(1500)
    ]
    ours = estimate(interquartile_mean, scores)
    assert ours.value == trim_mean(scores, 0.25, axis=None)
    assert (ours.low, ours.high) == pytest.approx(tuple(np.quantile(drawn, [0.025, 0.975])), abs=0.25)


def test_an_interval_covers_the_truth_about_as_often_as_it_says():
    """Percentile intervals of ten runs are a little short: about nine in ten cover, as Agarwal 2021 found."""
    rng = np.random.default_rng(0)
    found = [
        estimate(interquartile_mean, rng.normal(size=(10, 4)), seed=seed, resamples=500)
        for seed in range(100)
    ]
    covered = np.mean([one.low <= 0.0 <= one.high for one in found])
    assert 0.85 <= covered <= 0.99


def test_with_fewer_than_three_runs_of_a_task_there_is_no_interval():
    assert estimate(mean, np.array([1.0, 2.0])) == Estimate(1.5, None, None)
    assert estimate(mean, [[1.0, 2.0, 3.0], [1.0, 2.0]]).low is None
    assert estimate(mean, np.array([1.0, 2.0, 3.0])).low is not None
    assert probability_of_improvement([[1.0, 2.0, 3.0]], [[1.0, 2.0]]).low is None
    assert performance_profile(np.array([1.0, 2.0]), [0.0]).low is None


@given(scores=MATRICES, data=st.data())
@settings(max_examples=40)
def test_the_order_of_runs_plays_no_part(scores, data):
    shuffled = scores[data.draw(st.permutations(range(len(scores))))]
    for statistic in (interquartile_mean, mean, median, optimality_gap):
        assert point(statistic, shuffled) == pytest.approx(point(statistic, scores), abs=1e-9)
    assert point(interquartile_mean, scores) == pytest.approx(trim_mean(scores, 0.25, axis=None), abs=1e-9)


@given(score=SCORES, runs=st.integers(3, 8), tasks=st.integers(1, 3))
@settings(max_examples=25)
def test_equal_scores_have_an_interval_of_no_width(score, runs, tasks):
    for statistic in (interquartile_mean, mean, median):
        found = estimate(statistic, np.full((runs, tasks), score), resamples=FEW)
        assert [found.value, found.low, found.high] == pytest.approx([score] * 3, rel=1e-12, abs=1e-12)


@given(x=MATRICES, y=MATRICES)
@settings(max_examples=40)
def test_improvements_of_each_over_the_other_add_up_to_one(x, y):
    tasks = min(x.shape[1], y.shape[1])
    x, y = x[:, :tasks], y[:, :tasks]
    there = probability_of_improvement(x, y, resamples=FEW)
    back = probability_of_improvement(y, x, resamples=FEW)
    assert there.value + back.value == pytest.approx(1.0)
    plain = np.mean(
        [[(a > b) + 0.5 * (a == b) for a in one for b in other] for one, other in zip(x.T, y.T, strict=True)]
    )
    assert there.value == pytest.approx(plain)


@given(scores=MATRICES)
@settings(max_examples=40)
def test_profiles_fall(scores):
    profile = performance_profile(scores, np.linspace(-1001.0, 1001.0, 50), resamples=FEW)
    assert profile.value[0] == pytest.approx(1.0)
    assert profile.value[-1] == 0.0
    for one in (profile.value, profile.low, profile.high):
        assert one is None or (np.diff(one) <= 1e-12).all()


def test_equal_arguments_give_equal_results_and_another_seed_others():
    scores = np.random.default_rng(0).normal(size=(9, 2))
    assert estimate(mean, scores) == estimate(mean, scores)
    assert estimate(mean, scores) != estimate(mean, scores, seed=1)


def test_a_band_is_an_estimate_at_every_point():
    values = np.random.default_rng(0).normal(size=(5, 3))
    found = band(interquartile_mean, values, resamples=2000)
    each = [estimate(interquartile_mean, values[:, column], resamples=2000) for column in range(3)]
    assert found.value.tolist() == [one.value for one in each]
    assert found.low.tolist() == [one.low for one in each]
    assert found.high.tolist() == [one.high for one in each]


@pytest.mark.parametrize(
    ("scores", "sentence"),
    [
        ([], "a task has no scores, but every task must have one at least."),
        ([[1.0], []], "a task has no scores, but every task must have one at least."),
        ([1.0, float("nan")], "a score is not finite, but all must be."),
        (np.zeros((2, 2, 2)), "scores have 3 axes, but must have [runs] or [runs, tasks]."),
    ],
)
def test_what_is_no_score_is_a_sentence(scores, sentence):
    with pytest.raises(InputError) as caught:
        estimate(mean, scores)
    assert str(caught.value) == sentence


def test_only_equal_tasks_compare():
    with pytest.raises(InputError, match=r"^scores of 2 and of 1 tasks: only equal tasks compare\.$"):
        probability_of_improvement([[1.0], [2.0]], [[1.0]])
