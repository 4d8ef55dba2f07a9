"""How actions move the flange that a task commands."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

TWIST = ("x", "y", "z", "turn_x", "turn_y", "turn_z")
"""How a pose can move: along the world's axes, in [m], and about them, in [rad]."""


@dataclass(frozen=True)
class FlangeSteps:
    r"""Each number of an action moves the commanded flange along or about an axis of the world; the rest stays.

    A pose (p, R) becomes (p + S_p a, exp(S_R a) R), with S the `jacobian`: how the pose moves with the action, exactly
    for positions and to first order for turns. Steps add up: the k-th action of a chunk begins where the one before it
    ended.

    Raises:
        ValueError: If an axis is none of `TWIST`.
    """

    axes: tuple[str, ...]
    """What each number of an action moves, of `TWIST`."""
    position: tuple[float, float, float]
    """Where the flange is along the axes that no action moves, in [m]; along the others this is not looked at."""
    orientation: tuple[float, float, float, float]
    """Of the flange where no action turns it, (w, x, y, z)."""
    ahead: float = 0.0
    """How far ahead of the flange, along its z axis, the point is that is meant wherever this says flange, in [m]: the
    tip of a tool that actions turn about it. If any, the approach direction follows after the coordinates in the parts
    of the observation that say where the tip is and was told to be."""

    def __post_init__(self) -> None:
        for axis in self.axes:
            if axis not in TWIST:
                raise ValueError(f"An action cannot step along {axis!r}. Axes: {', '.join(TWIST)}.")

    @property
    def moved(self) -> list[int]:
        """Which of x, y and z actions move, in their order."""
        return [TWIST.index(axis) for axis in self.axes if axis in TWIST[:3]]

    @property
    def moving(self) -> list[int]:
        """Which numbers of an action do so."""
        return [i for i, axis in enumerate(self.axes) if axis in TWIST[:3]]

    @property
    def jacobian(self) -> Float[np.ndarray, "6 action"]:
        """How the commanded pose moves per unit of each number of an action: translation, then rotation."""
        return np.stack([np.eye(6)[TWIST.index(axis)] for axis in self.axes], axis=1)

    @property
    def approach(self) -> tuple[float, float, float]:
        """Approach direction where no action turns it: the flange's z axis."""
        w, x, y, z = self.orientation
        return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)

    def positions(self, coordinates: Float[np.ndarray, "*n moved"]) -> Float[np.ndarray, "*n 3"]:
        """Flange positions in the world, in [m], from their coordinates along the axes that actions move."""
        points = np.empty((*coordinates.shape[:-1], 3))
        points[...] = self.position
        points[..., self.moved] = coordinates
        return points
