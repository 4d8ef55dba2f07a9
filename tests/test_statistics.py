import numpy as np
import pytest
from scipy.special import expit
from scipy.stats import binom, permutation_test, sem, t

from benchmark.scoring.statistics import (
    Crossed,
    clustered_difference,
    clustered_mean,
    holm,
    paired_difference,
    paired_p_value,
    rate_interval,
    sign_flip_p_value,
)


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


def crossed(values):
    """A matrix (trainings, episodes) as rows."""
    trainings, episodes = np.indices(values.shape)
    return Crossed(values.astype(float).ravel(), trainings.ravel(), episodes.ravel())


def covers(rng, spread, trainings=3, episodes=60, repeats=400):
    """How often the clustered interval holds the true mean, where trainings differ by `spread` (logits)."""
    truth = expit(1.5 + spread * rng.standard_normal(50_000) + 1.5 * rng.standard_normal(50_000)).mean()
    hits = 0
    for _ in range(repeats):
        logit = 1.5 + spread * rng.standard_normal((trainings, 1)) + 1.5 * rng.standard_normal((1, episodes))
        _, low, high = clustered_mean(crossed(rng.random(logit.shape) < expit(logit)))
        hits += low <= truth <= high
    return hits / repeats


@pytest.mark.parametrize("spread", [0.0, 0.4, 1.0])
def test_the_clustered_interval_covers_the_truth_also_where_three_trainings_differ(spread):
    assert 0.92 < covers(np.random.default_rng(1), spread) < 1  # With no limits it would always.


def test_the_clustered_difference_covers_the_truth():
    rng, hits = np.random.default_rng(2), []
    for _ in range(300):
        effect = rng.normal(0.1, 0.05, (3, 1))
        threshold = rng.random((3, 60))
        treated, control = threshold < 0.6 + effect, threshold < 0.6
        _, low, high = clustered_difference(crossed(treated.astype(float) - control))
        hits.append(low <= 0.1 <= high)
    assert 0.92 < np.mean(hits) < 0.99


def test_sign_flips_of_one_training_are_mcnemars_test():
    rng = np.random.default_rng(5)
    treated, control = rng.random((2, 40)) < [[0.8], [0.6]]
    p_value = sign_flip_p_value(crossed((treated.astype(float) - control)[None]))
    assert p_value == pytest.approx(paired_p_value(treated, control), rel=1e-12)
    certain = sign_flip_p_value(crossed(np.ones((1, 500))))
    assert certain == pytest.approx(paired_p_value(np.ones(500), np.zeros(500)), rel=1e-12)


def test_sign_flips_are_counted_one_and_all():
    """Three trainings, scores with partial credit: SciPy goes through all flips of so few episodes."""
    differences = np.random.default_rng(7).choice([-1, -0.51, -0.49, 0, 0, 0.49, 0.51, 1], (3, 12))
    sums = differences.sum(axis=0)
    every = permutation_test((sums,), np.sum, permutation_type="samples", vectorized=True, n_resamples=np.inf)
    assert 0.01 < every.pvalue < 0.99 and every.null_distribution.size == 2**12
    assert sign_flip_p_value(crossed(differences)) == pytest.approx(every.pvalue)


def test_sign_flips_find_what_is_certain_of_these_trainings_and_nothing_where_there_is_nothing():
    """Also where trainings fail on the same episodes: flipped one by one, those would count as so many witnesses."""
    rng, found = np.random.default_rng(6), []
    for _ in range(200):
        scenes = rng.choice([-1, 0, 1], 50, p=[0.1, 0.8, 0.1])
        found.append(sign_flip_p_value(crossed(np.tile(scenes, (9, 1)))) < 0.05)
    assert np.mean(found) < 0.08
    wins = np.zeros((9, 50))
    wins[rng.integers(9, size=20), np.arange(20)] = 1
    assert sign_flip_p_value(crossed(wins)) < 0.001
    assert sign_flip_p_value(crossed(-wins)) == sign_flip_p_value(crossed(wins))


def test_with_one_training_the_interval_is_students_over_episodes():
    values = np.random.default_rng(3).normal(0.5, 0.1, (1, 200))
    mean, low, high = clustered_mean(crossed(values), extra=())
    expected = t.interval(0.95, 199, values.mean(), sem(values[0]))
    assert mean == pytest.approx(values.mean()) and (low, high) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("missing", "tolerance"), [(0.0, 0.01), (0.1, 0.06)])
def test_the_interval_is_that_of_a_bootstrap_of_trainings_and_episodes(missing, tolerance):
    """Drawn 200,000 times, of few of both; where some are missing the closed form is so to first order."""
    rng, trainings, episodes = np.random.default_rng(8), 4, 12
    values = (rng.random((trainings, episodes)) < rng.random((trainings, 1))).astype(float)
    values[rng.random(values.shape) < missing] = np.nan

    def variance(of_trainings, of_episodes):
        parts = np.nan_to_num(values), ~np.isnan(values)
        total, weight = (np.einsum("bi,ij,bj->b", of_trainings, part, of_episodes, optimize=True) for part in parts)
        return np.var(total[weight > 0] / weight[weight > 0])

    draws = [rng.multinomial(n - 1, np.full(n, 1 / n), 200_000) for n in (trainings, episodes)]
    by_training = variance(draws[0], np.ones_like(draws[1]))
    by_episode = variance(np.ones_like(draws[0]), draws[1])
    freedom = (by_training + by_episode) ** 2 / (by_training**2 / (trainings - 1) + by_episode**2 / (episodes - 1))
    half = t.ppf(0.975, freedom) * np.sqrt(variance(*draws))
    mean, low, high = clustered_difference(crossed(values), extra=())
    assert mean == pytest.approx(np.nanmean(values)) == (low + high) / 2
    assert (high - low) / 2 == pytest.approx(half, rel=tolerance)


def test_where_neither_trainings_nor_episodes_differ_on_average_the_interval_is_of_both_together():
    _, low, high = clustered_difference(crossed(np.array([[0.0, 0.1], [0.1, 0.0]])), extra=())
    assert (low, high) == pytest.approx((0.05 - t.ppf(0.975, 1) * 0.05, 0.05 + t.ppf(0.975, 1) * 0.05))
    for trainings in (1, 2):
        assert clustered_mean(crossed(np.full((trainings, 5), 0.25)), extra=()) == (0.25, 0.25, 0.25)


def test_more_trainings_that_agree_narrow_the_interval_and_missing_cells_do_no_harm():
    rng = np.random.default_rng(4)
    values = (rng.random((6, 100)) < 0.7).astype(float)
    width = [high - low for _, low, high in map(clustered_mean, map(crossed, (values[:2], values)))]
    assert width[1] < width[0]
    holes = np.where(rng.random(values.shape) < 0.2, np.nan, values)
    mean, low, high = clustered_mean(crossed(holes))
    assert mean == pytest.approx(np.nanmean(holes)) and low < 0.7 < high


def test_nothing_measured_is_no_number():
    assert np.isnan(clustered_mean(crossed(np.full((3, 5), np.nan)))).all()


def test_agreement_of_all_episodes_leaves_an_honest_interval():
    assert clustered_mean(crossed(np.ones((3, 50))))[1] == pytest.approx(rate_interval(np.ones(50))[0], abs=0.03)
    _, low, high = clustered_difference(crossed(np.zeros((3, 50))))
    assert (low, high) == pytest.approx(paired_difference(np.ones(50), np.ones(50))[1:], abs=0.01)
    assert sign_flip_p_value(crossed(np.zeros((3, 50)))) == 1


def test_holms_adjustment_by_hand():
    # Sorted: .01, .02, .03, .04 times 4, 3, 2, 1, and never below the one before.
    assert holm(np.array([0.04, 0.01, np.nan, 0.03, 0.02])) == pytest.approx(
        [0.06, 0.04, np.nan, 0.06, 0.06], nan_ok=True
    )
    assert np.isnan(holm(np.array([np.nan]))).all()
