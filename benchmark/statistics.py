"""Intervals and tests for rates and for paired differences, all at 95 %."""

import numpy as np
from jaxtyping import Float
from scipy.stats import norm
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.proportion import proportion_confint

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
    return float(difference.mean()), float(adjusted.mean() - half), float(adjusted.mean() + half)


def paired_p_value(treated: Float[np.ndarray, " n"], control: Float[np.ndarray, " n"]) -> float:
    """Exact McNemar test of two rates over the same episodes."""
    treated, control = np.asarray(treated, dtype=bool), np.asarray(control, dtype=bool)
    table = [
        [np.sum(treated & control), np.sum(treated & ~control)],
        [np.sum(~treated & control), np.sum(~treated & ~control)],
    ]
    return float(mcnemar(table, exact=True).pvalue)
