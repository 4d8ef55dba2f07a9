"""A way to do what is left of a task, where there are several."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Way:
    """A way to do what is left of a task."""

    goals: tuple[int, ...]
    """The parts of the scene that it leads to."""
    in_order: bool
    """Whether it leads to the first one first, or to any."""
    hidden: Bool[np.ndarray, " rest"]
    """Which numbers of what is seen of the scene are hidden to leave this way alone."""
    positions: Float[np.ndarray, "k 3"]
    directions: Float[np.ndarray, "k 3"]
    """Where the point that actions move is when it reaches its goals, in [m] in the world, and the approach directions
    there."""
