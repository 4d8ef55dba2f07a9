"""What is done to the executed action while the oracle labels: mistakes to recover from."""

import numpy as np
from jaxtyping import Float

NOISE_PROBABILITY = 0.2
"""Chance per step of noise on the executed action."""
NOISE_STD = 0.008
"""Its standard deviation per axis, in [m]."""
BURST_STEPS = (2, 5)
"""Fewest and most steps of a burst."""
BURST_SIZE = (0.008, 0.025)
"""Smallest and largest wrong step, in [m]."""
RESTART_PROBABILITY = 0.7
"""Chance that the oracle approaches the block anew after a burst."""


class Disturbance:
    """Turns the oracle's action into the one that is executed.

    Args:
        kind: "clean" executes the label; "noise" adds Gaussian noise to some steps; "bursts", "wide" and "crowded" also
            push a few steps in one wrong direction, with the label added in part.
        burst_probability: Chance per step that a burst begins.
        rng: Source of all randomness.
    """

    def __init__(self, kind: str, burst_probability: float, rng: np.random.Generator) -> None:
        self._noisy = kind != "clean"
        self._bursting = kind in ("bursts", "wide", "crowded")
        self._burst_probability = burst_probability
        self._rng = rng
        self._steps_left = 0
        self._wrong: np.ndarray = np.zeros(2)
        self._share = 0.0

    def __call__(self, label: Float[np.ndarray, "2"]) -> tuple[Float[np.ndarray, "2"], bool]:
        """Executed action in [m], and whether the oracle should approach the block anew after it."""
        if self._steps_left == 0 and self._bursting and self._rng.random() < self._burst_probability:
            self._begin_burst()
        if self._steps_left > 0:
            self._steps_left -= 1
            restart = self._steps_left == 0 and self._rng.random() < RESTART_PROBABILITY
            return self._wrong + self._share * label, restart
        if self._noisy and self._rng.random() < NOISE_PROBABILITY:
            return label + self._rng.normal(0, NOISE_STD, 2), False
        return label, False

    def _begin_burst(self) -> None:
        angle = self._rng.uniform(0, 2 * np.pi)
        size = self._rng.uniform(*BURST_SIZE)
        self._steps_left = int(self._rng.integers(BURST_STEPS[0], BURST_STEPS[1] + 1))
        self._wrong = size * np.array([np.cos(angle), np.sin(angle)])
        self._share = self._rng.random()
