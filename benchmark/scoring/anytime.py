r"""Tests and intervals that hold whenever one stops to look: two policies on the same scenes, pair after pair.

Pairs in which both succeed or both fail say nothing of which is better. Of those that differ, w were won by the first
policy and l by the second; without a difference, each is a fair coin. The test is a bet against that which cannot be
expected to gain, whoever stops it when: a mixture over all coins, p ~ Beta(1, 1) (Robbins, Ann. Math. Stat. 1970;
Ramdas et al., Stat. Sci. 2023, "Game-theoretic statistics and safe anytime-valid inference"), with

.. math:: e = \frac{B(1 + w, 1 + l)}{B(1, 1)} \, 2^{w + l}.

By Ville's inequality it ever reaches :math:`1 / \alpha` with a chance of at most :math:`\alpha`.
"""

import math

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import bisect
from scipy.special import betaln, gammaln, xlogy


def log_e_value(won: Int[np.ndarray, "*n"], lost: Int[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Logarithm of the evidence against a fair coin; it counts either side alike."""
    won, lost = np.asarray(won), np.asarray(lost)
    return betaln(1.0 + won, 1.0 + lost) - betaln(1.0, 1.0) + (won + lost) * math.log(2)


def evidence(differences: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The evidence after each pair.

    Args:
        differences: Of each pair in the order in which they came: 1, 0 or -1.
    """
    won, lost = np.cumsum(differences > 0), np.cumsum(differences < 0)
    return np.exp(np.minimum(log_e_value(won, lost), 700.0))  # Beyond it is no number.


def first_clear(differences: Int[np.ndarray, " n"], alpha: float) -> int | None:
    """After how many pairs the evidence first reached 1 / alpha; None if it never did.

    Args:
        differences: Of each pair in the order in which they came: 1, 0 or -1.
        alpha: How often, at most, this is to happen without a difference.
    """
    clear = evidence(differences) >= 1 / alpha
    return int(clear.argmax()) + 1 if clear.any() else None


def anytime_difference(differences: Int[np.ndarray, " n"], alpha: float) -> tuple[float, float, float]:
    r"""Mean of paired differences 1, 0 and -1, and an interval that holds for all n at once but for a chance of alpha.

    The same bet on three outcomes, with a uniform mixture over their chances :math:`p` (Lindon & Malek, NeurIPS 2022):
    it holds all :math:`p` with :math:`\frac{\Gamma(3) \prod_i \Gamma(c_i + 1)}{\Gamma(n + 3)} < \frac{1}{\alpha}
    \prod_i p_i^{c_i}`, and of these the differences of two. No pairs leave -1 to 1.
    """
    counts = np.array([np.sum(differences > 0), np.sum(differences < 0), np.sum(differences == 0)])
    n = int(counts.sum())
    if n == 0:
        return math.nan, -1.0, 1.0
    least = gammaln(3) + gammaln(counts + 1).sum() - gammaln(n + 3) + math.log(alpha)

    def excess(delta: float) -> float:
        return max(_best_likelihood(counts, delta) - least, -1e9)

    mean = float(np.mean(differences))
    ends = (end if excess(end) >= 0 else float(bisect(excess, mean, end, xtol=1e-6)) for end in (-1.0, 1.0))
    low, high = ends
    return mean, low, high


def _best_likelihood(counts: Int[np.ndarray, "3"], delta: float) -> float:
    """Logarithm of the likelihood of won, lost and even pairs, at its greatest where won minus lost are delta.

    With q the chance that a pair differs, it is greatest at the larger root of a square (Tango, Stat. Med. 1998).
    """
    won, lost, even = map(int, counts)
    n, half = won + lost + even, (won + lost + delta * (won - lost)) / 2
    root = max(half**2 - n * (delta * (won - lost) - even * delta**2), 0.0)
    q = float(np.clip((half + math.sqrt(root)) / n, abs(delta), 1.0))
    return float(xlogy(won, (q + delta) / 2) + xlogy(lost, (q - delta) / 2) + xlogy(even, 1 - q))
