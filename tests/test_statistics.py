import numpy as np
import pytest
from scipy.stats import binom

from benchmark.statistics import paired_difference, paired_p_value, rate_interval


def test_published_wilson_intervals():
    low, high = rate_interval(np.array([1.0] * 27 + [0.0] * 23))
    assert (round(low, 2), round(high, 2)) == (0.40, 0.67)
    assert rate_interval(np.ones(50))[0] == pytest.approx(0.93, abs=0.005)


def test_partial_credit_lies_between():
    low, high = rate_interval(np.array([1.0, 0.49, 0.0, 0.49]))
    assert 0 < low < 0.495 < high < 1


def test_the_exact_test_is_the_binomial_one():
    treated = np.array([True] * 9 + [False] * 2 + [True] * 5)
    control = np.array([False] * 9 + [True] * 2 + [True] * 5)
    assert paired_p_value(treated, control) == pytest.approx(2 * binom.cdf(2, 11, 0.5))


def test_the_paired_interval_covers_its_difference_as_often_as_it_says():
    rng = np.random.default_rng(0)
    covered = []
    for _ in range(2000):
        u = rng.random(60)
        treated, control = u < 0.8, np.where(rng.random(60) < 0.7, u < 0.7, rng.random(60) < 0.7)
        _, low, high = paired_difference(treated, control)
        covered.append(low <= 0.1 <= high)
    assert 0.93 < np.mean(covered) < 0.98


def test_pairs_that_never_differ_leave_an_interval_about_zero():
    difference, low, high = paired_difference(np.ones(50), np.ones(50))
    assert difference == 0 and low < 0 < high
