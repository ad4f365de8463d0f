"""Lorenz curves and Gini coefficients with known answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.analysis.measure.workload import gini, lorenz_curve

WORK = st.lists(st.integers(0, 1000), min_size=1, max_size=20).filter(any)


def test_the_curve_of_one_two_and_five():
    """Robots in the order of their work: 1, then 1 + 2, then 8 of 8."""
    assert lorenz_curve([5, 1, 2]).tolist() == [
        [0.0, 0.0],
        [pytest.approx(1 / 3), 1 / 8],
        [pytest.approx(2 / 3), 3 / 8],
        [1.0, 1.0],
    ]


@pytest.mark.parametrize(
    ("work", "expected"),
    [
        ([4, 4, 4], 0.0),
        ([0, 0, 0, 12], 3 / 4),
        ([1, 2, 5], 1 - 2 * (1 / 3) * (1 / 16 + 4 / 16 + 11 / 16)),
        ([0, 1], 1 / 2),
        ([1, 3], 1 / 4),
        ([7], 0.0),
    ],
)
def test_known_coefficients(work, expected):
    assert gini(work) == pytest.approx(expected, abs=1e-15)


def test_no_work_has_no_curve():
    assert lorenz_curve([0, 0]) is None
    assert gini([0, 0]) is None


@given(WORK)
def test_it_is_half_the_relative_mean_difference(work):
    """Gini's other formula: the mean difference between two robots, over twice the mean."""
    differences = sum(abs(a - b) for a in work for b in work)
    assert gini(work) == pytest.approx(differences / (2 * len(work) * sum(work)), abs=1e-12)
    assert 0.0 <= gini(work) <= 1.0 - 1.0 / len(work) + 1e-12


@given(WORK, st.floats(0.001, 1000.0), st.randoms(use_true_random=False))
def test_neither_order_nor_unit_matters(work, unit, random):
    other = [unit * one for one in work]
    random.shuffle(other)
    assert gini(other) == pytest.approx(gini(work), abs=1e-12)


@given(WORK)
def test_the_curve_is_convex_below_the_diagonal_from_corner_to_corner(work):
    curve = lorenz_curve(work)
    assert curve[0].tolist() == [0.0, 0.0]
    assert curve[-1] == pytest.approx([1.0, 1.0])
    assert (np.diff(curve[:, 1], 2) >= -1e-12).all()
    assert (curve[:, 1] <= curve[:, 0] + 1e-12).all()
