"""What a task asks of an arm."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

FOUND = "found"
"""What a branch is called that no file states."""


@dataclass(frozen=True)
class TaskPoses:
    """What a task asks of an arm: to hold its tool upright over its start, and from there what it is judged by."""

    start: tuple[float, float, float]
    """Of the flange, in [m] in the world."""
    lower: tuple[float, float]
    """Corner of the box of poses, xy in [m] in the world; all are at the start's height."""
    upper: tuple[float, float]
    """The opposite corner."""
    spacing: float = 0.05
    """Between poses, in [m]."""
    branch: str | None = None
    """In which branch arms do the task unless they are told otherwise, such as `found`; None for what an arm's file
    says, which is about block push."""
    share_done: str | None = None
    """How much of the task an arm does from its posture, a number from 0 to 1 by which a posture is found: a function
    of the `PlacedArm`, as `module:name`. None for the share of the poses that it follows."""

    def points(self) -> Float[np.ndarray, "n 2"]:
        """The poses' xy, in [m] in the world."""
        ends = zip(self.lower, self.upper, strict=True)
        x, y = (np.linspace(low, high, 1 + round((high - low) / self.spacing)) for low, high in ends)
        return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
