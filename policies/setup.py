"""What a method of guidance is made with."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from policies.arm_controller import ArmController
from policies.episode_model import EpisodeModel
from richmap.similarity.load_field import StoredField
from richmap.similarity.signed_distance import SignedDistanceField
from richmap.task_spaces.task_space import TaskSpace


@dataclass(frozen=True)
class Setup:
    """One arm in one task."""

    scale: float
    """Of the method, in its own unit."""
    field: StoredField | None
    """What it looks at, if anything."""
    base: tuple[float, float]
    """Position of the arm's base, x and y in [m]."""
    seed: int
    """Of what is random."""
    space: TaskSpace
    """The task's numbers, and what its actions do to the flange."""
    model: EpisodeModel | None = None
    """What episodes on the arm are imagined with, if the method does so."""
    controller: ArmController | None = None
    """The arm's own controller, if the method asks it."""
    among: Callable[[Float[np.ndarray, "k 4"]], SignedDistanceField] | None = None
    """Where the arm can hold its tool among obstacles at some places (`policies.guidance.Guidance.meet`), if the
    method's field is of that, the method keeps the arm off them, and there are any."""
