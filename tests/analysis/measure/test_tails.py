"""Power laws: known exponents found again, and no fit where there is nothing to fit."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.analysis.measure.tails import LEAST, LEAST_IN_TAIL, fit_power_law, survival


def draw(alpha, count, least=1.0, seed=0):
    """By inversion: P(T > t) = (t / least)^(1 - alpha)."""
    return least * np.random.default_rng(seed).random(count) ** (-1.0 / (alpha - 1.0))


@pytest.mark.parametrize("alpha", [1.5, 2.0, 2.5, 3.5])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_exponent_of_drawn_values_is_found_within_three_standard_errors(alpha, seed):
    fit = fit_power_law(draw(alpha, 1500, 0.3, seed))
    assert abs(fit.alpha - alpha) < 3.0 * fit.error
    assert fit.error == pytest.approx((fit.alpha - 1.0) / math.sqrt(fit.values))
    assert fit.values > 100


def test_the_tail_is_found_behind_a_body_that_is_no_power_law():
    rng = np.random.default_rng(3)
    values = np.concatenate([rng.uniform(1.0, 5.0, 1500), draw(2.5, 1500, 5.0, 4)])
    fit = fit_power_law(values)
    assert 4.0 < fit.t_min < 9.0
    assert abs(fit.alpha - 2.5) < 3.0 * fit.error
    assert fit.values == (values >= fit.t_min).sum()


def test_the_exponent_is_the_likeliest_of_its_tail():
    values = draw(2.2, 300, seed=5)
    fit = fit_power_law(values)
    tail = values[values >= fit.t_min]

    def likelihood(alpha):
        return float(np.log((alpha - 1.0) / fit.t_min * (tail / fit.t_min) ** -alpha).sum())

    assert likelihood(fit.alpha) > max(likelihood(fit.alpha - 0.01), likelihood(fit.alpha + 0.01))
    assert fit.alpha == pytest.approx(1.0 + len(tail) / sum(math.log(t / fit.t_min) for t in tail))


def _distance(values, t_min):
    """The largest gap between the shares above and below every value, and the fit; slow and plain."""
    tail = sorted(t for t in values if t >= t_min)
    alpha = 1.0 + len(tail) / sum(math.log(t / t_min) for t in tail)
    gaps = []
    for t in tail:
        fitted = 1.0 - (t / t_min) ** (1.0 - alpha)
        below, up_to = sum(one < t for one in tail), sum(one <= t for one in tail)
        gaps += [abs(fitted - below / len(tail)), abs(fitted - up_to / len(tail))]
    return max(gaps)


def test_no_other_beginning_of_the_tail_fits_better():
    """Values as lapses are: whole numbers of decisions, so that many are the same."""
    values = np.ceil(draw(2.0, 120, seed=6) / 0.3) * 0.3
    fit = fit_power_law(values)
    assert fit.distance == pytest.approx(_distance(values, fit.t_min))
    starts = [t for t in np.unique(values) if (values >= t).sum() >= LEAST_IN_TAIL and t < values.max()]
    assert fit.distance <= min(_distance(values, t) for t in starts) + 1e-12


def test_few_values_or_equal_ones_have_no_fit():
    values = draw(2.0, LEAST)
    assert fit_power_law(values) is not None
    assert fit_power_law(values[1:]) is None
    assert fit_power_law([2.1] * 500) is None
    assert fit_power_law([]) is None
    assert fit_power_law([*values[1:], 0.0, 0.0]) is None, "what took no time does not count"


def test_a_handful_of_values_is_no_tail():
    """The five largest would fit much better than all do."""
    values = [1.0] * LEAST + [100.0, 120.0, 150.0, 200.0, 400.0]
    assert _distance(values, 100.0) < 0.3 < _distance(values, 1.0)
    assert fit_power_law(values).values == len(values)


@given(st.integers(0, 2**32), st.floats(0.01, 100.0))
def test_the_unit_of_time_does_not_matter(seed, unit):
    values = draw(2.3, 60, seed=seed)
    one, other = fit_power_law(values), fit_power_law(unit * values)
    assert other.alpha == pytest.approx(one.alpha, rel=1e-6)
    assert other.t_min == pytest.approx(unit * one.t_min)


@given(st.lists(st.sampled_from([0.3, 0.6, 0.9, 30.0]), min_size=0, max_size=120))
def test_a_fit_is_finite_or_none(values):
    fit = fit_power_law(values)
    if len(values) < LEAST or len(set(values)) == 1:
        assert fit is None
    if fit is not None:
        assert math.isfinite(fit.alpha)
        assert fit.alpha > 1.0
        assert math.isfinite(fit.error)
        assert 0.0 <= fit.distance <= 1.0


def test_survival_of_values_among_which_some_are_the_same():
    values, share = survival([3.0, 1.0, 2.0, 2.0])
    assert values.tolist() == [1.0, 2.0, 2.0, 3.0]
    assert share.tolist() == [1.0, 0.75, 0.75, 0.25]
    assert [len(part) for part in survival([])] == [0, 0]
