"""A way around blocks for the demonstrator, whose own ways are straight."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

KEEP_OFF = 0.04
"""Distance that is kept from blocks' centres, in [m]: half a diagonal, the pusher's radius, and some."""
LOOK = 0.08
"""Distance from a block's centre at which the way begins to bend, in [m]."""


def detour(
    step: Float[np.ndarray, "2"],
    effector: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    blocks: Iterable[Float[np.ndarray, "2"]],
) -> Float[np.ndarray, "2"]:
    """The step turned aside, the more the nearer the block, so as to pass it; all in [m].

    It stays as it is where it leads past the blocks or away from them, or to a goal at a block; closer to one than is
    kept it leads outwards, too. It depends on what is seen now alone, so that a policy can learn it.
    """
    length = np.linalg.norm(step)
    if length == 0:
        return step
    heading = step / length
    for block in blocks:
        away = effector - block
        distance = np.linalg.norm(away)
        radial = away / max(distance, 1e-9)
        aside = np.array([-radial[1], radial[0]])
        across = float(aside @ heading)
        passes = distance * abs(across) > KEEP_OFF or radial @ heading >= 0
        if distance > LOOK or passes or np.linalg.norm(goal - block) < KEEP_OFF:
            continue
        weight = min(1.0, (LOOK - distance) / (LOOK - KEEP_OFF))
        outward = max(0.0, 1 - distance / KEEP_OFF)
        heading = (1 - weight) * heading + weight * np.copysign(1.0, across) * aside + 2 * outward * radial
        heading /= np.linalg.norm(heading)
    return length * heading
