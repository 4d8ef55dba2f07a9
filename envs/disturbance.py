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
"""Chance that the oracle approaches its goal anew after a burst."""
IN_PLANE = np.ones(2)
"""Sizes of a step in the plane."""


class Disturbance:
    """Turns the oracle's action into the one that is executed.

    Args:
        kind: "clean" executes the label; "noise" adds Gaussian noise to some steps; all others also go a few steps in
            one wrong direction, with the label added in part.
        burst_probability: Chance per step that a burst begins.
        rng: Source of all randomness.
        sizes: Of the disturbance of each number of an action, per metre of `NOISE_STD` and `BURST_SIZE`.
    """

    def __init__(
        self,
        kind: str,
        burst_probability: float,
        rng: np.random.Generator,
        sizes: Float[np.ndarray, " action"] = IN_PLANE,
    ) -> None:
        self._noisy = kind != "clean"
        self._bursting = kind not in ("clean", "noise")
        self._burst_probability = burst_probability
        self._rng = rng
        self._sizes = sizes
        self._steps_left = 0
        self._wrong: np.ndarray = np.zeros(len(sizes))
        self._share = 0.0

    def __call__(self, label: Float[np.ndarray, " action"]) -> tuple[Float[np.ndarray, " action"], bool]:
        """Executed action, and whether the oracle should approach its goal anew after it."""
        if self._steps_left == 0 and self._bursting and self._rng.random() < self._burst_probability:
            self._begin_burst()
        if self._steps_left > 0:
            self._steps_left -= 1
            restart = self._steps_left == 0 and self._rng.random() < RESTART_PROBABILITY
            return self._wrong + self._share * label, restart
        if self._noisy and self._rng.random() < NOISE_PROBABILITY:
            return label + self._rng.normal(0, NOISE_STD, len(label)) * self._sizes, False
        return label, False

    def _begin_burst(self) -> None:
        direction = self._direction()
        size = self._rng.uniform(*BURST_SIZE)
        self._steps_left = int(self._rng.integers(BURST_STEPS[0], BURST_STEPS[1] + 1))
        self._wrong = size * self._sizes * direction
        self._share = self._rng.random()

    def _direction(self) -> Float[np.ndarray, " action"]:
        """Evenly drawn unit vectors: one in the plane, or one of the step and one of the turn."""
        if len(self._sizes) == 2:
            angle = self._rng.uniform(0, 2 * np.pi)
            return np.array([np.cos(angle), np.sin(angle)])
        both = self._rng.normal(size=(2, 3))
        return (both / np.linalg.norm(both, axis=1, keepdims=True)).ravel()
