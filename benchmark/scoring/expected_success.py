"""What block push can be expected to come to on an arm before it acts: by the share of the source's steps it loses.

The figures are those of `benchmark.studies.dose_response` (`results/dose_response`).
"""

import math

import numpy as np
from jaxtyping import Float

CURVE = (2.582257, -24.36323)
"""Intercept and slope of the log odds of success over the share of steps that cannot be followed, of the first two
thirds of the study's arms."""
MARGIN = 0.089854
"""How far success on its last third is from that curve, in nine arms of ten."""


def on_curve(curve: tuple[float, float], lost: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Success that a curve predicts from shares of lost steps."""
    return 1 / (1 + np.exp(-(curve[0] + curve[1] * lost)))


def margin(off: Float[np.ndarray, " n"], share: float = 0.9) -> float:
    """How far at most another arm of the same kind is off, with that probability, where these were off by so much:
    split conformal prediction (Lei et al., JASA 2018). Infinite where they are too few to say."""
    rank = math.ceil(share * (len(off) + 1))
    return float(np.sort(np.abs(off))[rank - 1]) if rank <= len(off) else math.inf


def expected_success(lost: float) -> tuple[float, float, float]:
    """Success of direct transfer of block push on an arm that loses a share of the source's steps, and from where to
    where it lies on nine arms of ten."""
    (expected,) = on_curve(CURVE, np.array([lost]))
    return float(expected), max(0.0, float(expected) - MARGIN), min(1.0, float(expected) + MARGIN)
