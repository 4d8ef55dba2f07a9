"""The test that may be looked at after every pair: its closed form, its error rate, its power, its interval."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

from benchmark.scoring.anytime import _best_likelihood, anytime_difference, evidence, first_clear, log_e_value

RUNS, PAIRS, ALPHA = 4000, 500, 0.05


def after(won, lost):
    return float(np.exp(log_e_value(np.array(won), np.array(lost))))


@pytest.mark.parametrize(
    "won, lost, expected", [(0, 0, 1), (1, 0, 1), (2, 0, 4 / 3), (1, 1, 2 / 3), (8, 0, 256 / 9), (5, 2, 128 / 168)]
)
def test_small_counts_by_hand(won, lost, expected):
    """2^n w! l! / (n + 1)!"""
    assert after(won, lost) == pytest.approx(expected) == pytest.approx(after(lost, won))


def test_it_is_the_mean_of_likelihood_ratios_over_all_coins():
    ratio, _ = quad(lambda p: (p / 0.5) ** 9 * ((1 - p) / 0.5) ** 4, 0, 1)
    assert after(9, 4) == pytest.approx(ratio)


@pytest.mark.parametrize("won, lost", [(0, 0), (3, 1), (0, 6)])
def test_a_bet_on_a_fair_coin_is_expected_to_gain_nothing(won, lost):
    expected = (after(won + 1, lost) + after(won, lost + 1)) / 2
    assert expected == pytest.approx(after(won, lost))


def ever_clear(rng, chances):
    """How often evidence ever suffices within these pairs, looked at after each: chances of 1, -1 and 0."""
    differences = rng.choice([1, -1, 0], (RUNS, PAIRS), p=chances)
    won, lost = np.cumsum(differences > 0, axis=1), np.cumsum(differences < 0, axis=1)
    return float((log_e_value(won, lost) >= -math.log(ALPHA)).any(axis=1).mean())


@pytest.mark.parametrize("share", [1.0, 0.3, 0.05])
def test_without_a_difference_it_is_rarely_clear_whenever_one_stops(share):
    assert ever_clear(np.random.default_rng(0), [share / 2, share / 2, 1 - share]) <= ALPHA


def test_a_difference_of_ten_points_is_found():
    assert ever_clear(np.random.default_rng(1), [0.20, 0.10, 0.70]) > 0.85
    assert ever_clear(np.random.default_rng(1), [0.10, 0.20, 0.70]) > 0.85


def test_it_is_clear_from_the_pair_on_that_suffices():
    differences = np.array([0, 1, 1, 1, 1, 1, 1, 1, 0, 1])
    assert evidence(differences).tolist() == pytest.approx([after(n, 0) for n in (0, 1, 2, 3, 4, 5, 6, 7, 7, 8)])
    assert after(7, 0) < 20 <= after(8, 0)
    assert first_clear(differences, 0.05) == 10 and first_clear(differences[:9], 0.05) is None
    assert first_clear(-differences, 0.05) == 10 and first_clear(differences, 0.25) == 6
    assert first_clear(differences[:0], 0.05) is None
    assert evidence(np.ones(5000, int))[-1] > 1e300


@pytest.mark.parametrize("counts, delta", [((7, 2, 11), 0.0), ((7, 2, 11), -0.4), ((0, 3, 5), 0.2), ((4, 0, 0), 0.9)])
def test_the_greatest_likelihood_of_a_difference_is_that_of_a_search(counts, delta):
    def unlikely(q):
        chances = (q + delta) / 2, (q - delta) / 2, 1 - q
        return -sum(n * math.log(p) for n, p in zip(counts, chances, strict=True) if n)

    found = minimize_scalar(unlikely, bounds=(abs(delta) + 1e-12, 1 - 1e-12), method="bounded", options={"xatol": 1e-9})
    assert _best_likelihood(np.array(counts), delta) == pytest.approx(-found.fun, abs=1e-5)


def test_the_interval_holds_at_all_times_at_once():
    rng, ever_out = np.random.default_rng(2), 0
    for _ in range(60):
        differences = rng.choice([1, -1, 0], 200, p=[0.25, 0.15, 0.6])
        looks = (anytime_difference(differences[:n], ALPHA) for n in (5, 20, 60, 120, 200))
        ever_out += any(not low <= 0.1 <= high for _, low, high in looks)
    assert ever_out <= 0.1 * 60


def test_the_interval_narrows_turns_with_the_sign_and_begins_with_everything():
    differences = np.tile([1, 0, 0, -1, 1, 0, 0, 0, 1, 0], 30)
    few, many = anytime_difference(differences[:30], ALPHA), anytime_difference(differences, ALPHA)
    assert many[0] == pytest.approx(0.2) and few[1] < many[1] < 0.2 < many[2] < few[2]
    assert anytime_difference(-differences, ALPHA)[1:] == pytest.approx((-many[2], -many[1]), abs=1e-5)
    assert anytime_difference(differences[:0], ALPHA)[1:] == (-1, 1)
    assert anytime_difference(np.ones(9, int), ALPHA)[2] == 1
