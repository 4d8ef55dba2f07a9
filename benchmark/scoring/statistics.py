"""Intervals and tests for rates and for paired differences, all at 95 %."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.stats import norm, t
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 0.95


def rate_interval(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Wilson interval of the mean of values in [0, 1].

    Exact in level for rates; for a score with partial credit it is conservative, since no distribution on [0, 1] with
    the same mean varies more than a rate.
    """
    low, high = proportion_confint(float(np.sum(values)), len(values), alpha=1 - LEVEL, method="wilson")
    return float(low), float(high)


def paired_difference(treated: Float[np.ndarray, " n"], control: Float[np.ndarray, " n"]) -> tuple[float, float, float]:
    """Mean of treated - control over the same episodes, with the interval of Bonett & Price (2012).

    Theirs is the Wald interval after one more pair in each direction; it stays honest where no pair differs.
    """
    difference = np.asarray(treated, dtype=float) - np.asarray(control, dtype=float)
    adjusted = np.append(difference, [1.0, -1.0])
    half = norm.ppf(0.5 + LEVEL / 2) * adjusted.std() / np.sqrt(len(adjusted))
    low, high = np.clip([adjusted.mean() - half, adjusted.mean() + half], -1, 1)
    return float(difference.mean()), float(low), float(high)


def paired_p_value(treated: Float[np.ndarray, " n"], control: Float[np.ndarray, " n"]) -> float:
    """Exact McNemar test of two rates over the same episodes."""
    treated, control = np.asarray(treated, dtype=bool), np.asarray(control, dtype=bool)
    table = [
        [np.sum(treated & control), np.sum(treated & ~control)],
        [np.sum(~treated & control), np.sum(~treated & ~control)],
    ]
    return float(mcnemar(table, exact=True).pvalue)


@dataclass(frozen=True)
class Crossed:
    """Values of which each belongs to a training and to an episode, the same episodes for all trainings."""

    values: Float[np.ndarray, " n"]
    """NaN where nothing was measured."""
    trainings: Shaped[np.ndarray, " n"]
    """What is a training by itself: the training seed, whatever its checkpoint."""
    episodes: Int[np.ndarray, " n"]
    """Episode seeds."""

    @classmethod
    def of(cls, rows: "pd.DataFrame", values: "pd.Series") -> "Crossed":
        """Values of these rows, each by its row's policy and episode."""
        return cls(values.to_numpy(float), rows.checkpoint_hash.to_numpy(str), rows.episode_seed.to_numpy())


def clustered_mean(rows: Crossed, extra: Sequence[float] = (0.0, 0.0, 1.0, 1.0)) -> tuple[float, float, float]:
    """Mean of values in [0, 1] with its interval for other trainings and other episodes.

    Args:
        rows: The values. Of one training, the interval is for other episodes alone.
        extra: Values of made-up episodes that count for the interval only, so that it stays honest where all episodes
            agree (Agresti & Coull 1998); none for what is not a rate.
    """
    mean, centre, half = _crossed_bootstrap(rows, extra)
    return mean, float(np.maximum(0, centre - half)), float(np.minimum(1, centre + half))


def clustered_difference(differences: Crossed, extra: Sequence[float] = (-1.0, 1.0)) -> tuple[float, float, float]:
    """Mean of paired differences of values in [0, 1], and its interval for other trainings and other episodes.

    As `clustered_mean`; the made-up pairs are those of `paired_difference`.
    """
    mean, centre, half = _crossed_bootstrap(differences, extra)
    return mean, float(np.maximum(-1, centre - half)), float(np.minimum(1, centre + half))


def clustered_ratio(top: Crossed, bottom: Crossed) -> tuple[float, float, float]:
    """Sum of some values divided by that of others, of the same trainings and episodes, and its interval for other
    trainings and other episodes, to first order (the delta method).

    NaN where the divisor's sum is not above 0.
    """
    below = float(bottom.values.sum())
    if not below > 0:
        return (math.nan,) * 3
    ratio = float(top.values.sum()) / below
    linear = ratio + (top.values - ratio * bottom.values) / bottom.values.mean()
    _, centre, half = _crossed_bootstrap(replace(top, values=linear), ())
    return ratio, centre - half, centre + half


def sign_flip_p_value(differences: Crossed) -> float:
    """Whether these trainings differ: the share of all sign flips, of whole episodes, with a mean as far from 0.

    All of them are counted, by convolution (Pagano & Tritchler, JASA 1983), which SciPy's `permutation_test` does for
    few episodes alone. What holds for other trainings as well, the interval of `clustered_difference` says. Of one
    training and a rate it is the exact McNemar test.

    Args:
        differences: Of scores with two decimals; NaN comes of others, whose sums are too many to be counted.
    """
    sums, _ = _table(differences)
    if not sums.size:
        return math.nan
    of_episodes = np.rint(100 * sums.sum(axis=0)).astype(int)
    if not np.allclose(of_episodes, 100 * sums.sum(axis=0)):
        return math.nan
    steps = np.abs(of_episodes[of_episodes != 0])
    if not len(steps):
        return 1.0
    unit = np.gcd.reduce(steps)
    chance: np.ndarray = np.ones(1)  # chance[k]: that the steps which are turned downwards add up to k.
    for step in steps // unit:
        chance = (np.pad(chance, (0, step)) + np.pad(chance, (step, 0))) / 2
    total = steps.sum() // unit - 2 * np.arange(len(chance))
    return float(np.minimum(1, chance[np.abs(total) >= abs(of_episodes.sum()) // unit].sum()))


def holm(p_values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """p-values adjusted for all that are asked together (Holm 1979); NaN stays NaN and does not count."""
    p_values = np.array(p_values, dtype=float)
    asked = ~np.isnan(p_values)
    if asked.any():
        p_values[asked] = multipletests(p_values[asked], method="holm")[1]
    return p_values


def _crossed_bootstrap(rows: Crossed, extra: Sequence[float]) -> tuple[float, float, float]:
    """Mean over trainings and episodes, centre and half width of its interval.

    Trainings and episodes are both resampled, and their weights multiply (Owen & Eckles, Ann. Appl. Stat. 2012: the
    variance is mildly too large). Of m units m - 1 are drawn, which keeps it from being too small for few (Rao & Wu,
    JASA 1988). The variance over all such draws has a closed form, exact where every training has every episode and to
    first order where some are missing; nothing is drawn. Percentiles over three training seeds would cover only 80 %
    where these differ, so the interval is that of Student's t, with Satterthwaite's degrees of freedom from the
    variances that each factor has alone.
    """
    sums, counts = _table(rows)
    if not sums.size:
        return (math.nan,) * 3
    mean = float(sums.sum() / counts.sum())
    made_up = np.full((len(sums), len(extra)), counts.max())
    sums, counts = np.hstack([sums, made_up * np.array(extra, dtype=float)]), np.hstack([counts, made_up])
    trainings, episodes = sums.shape
    centre = float(sums.sum() / counts.sum())
    if episodes < 2:
        return mean, centre, math.inf  # Nothing is known of others.
    deviations = (sums - counts * centre) / counts.mean()
    of_training, of_episode = deviations.mean(axis=1), deviations.mean(axis=0)
    of_both = deviations - of_training[:, None] - of_episode
    pairs_of_trainings, pairs_of_episodes = trainings * max(trainings - 1, 1), episodes * (episodes - 1)
    by_training = float(np.sum(of_training**2)) / pairs_of_trainings
    by_episode = float(np.sum(of_episode**2)) / pairs_of_episodes
    variance = by_training + by_episode + float(np.sum(of_both**2)) / (pairs_of_trainings * pairs_of_episodes)
    if variance == 0:
        return mean, centre, 0.0
    freedom = float((trainings - 1) * (episodes - 1))  # Of what neither factor has alone, should there be nothing else.
    if by_training + by_episode > 0:
        freedom = (by_training + by_episode) ** 2 / (
            by_training**2 / max(trainings - 1, 1) + by_episode**2 / (episodes - 1)
        )
    if freedom == 0:
        return mean, centre, math.inf
    return mean, centre, float(t.ppf(0.5 + LEVEL / 2, freedom) * math.sqrt(variance))


def _table(rows: Crossed) -> tuple[Float[np.ndarray, "trainings episodes"], Float[np.ndarray, "trainings episodes"]]:
    """Sum and number of the values of each training and episode."""
    there = ~np.isnan(rows.values)
    trainings, training = np.unique(rows.trainings[there], return_inverse=True)
    episodes, episode = np.unique(rows.episodes[there], return_inverse=True)
    sums, counts = np.zeros((2, len(trainings), len(episodes)))
    np.add.at(sums, (training, episode), rows.values[there])
    np.add.at(counts, (training, episode), 1.0)
    return sums, counts
