"""How far outside of what an arm can hold a straight push would lead its pusher."""

import numpy as np
from jaxtyping import Float

from richmap.similarity.signed_distance import SignedDistanceField
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE, PLACED

APPROACH, CONTACT = 0.05, 0.03
"""Distances of the pusher behind the block's centre, in [m]: where a push is approached from, and while it lasts."""
POINTS = 16
"""Of the pusher's way that are looked at."""


def overreach(
    distance: SignedDistanceField,
    blocks: Float[np.ndarray, "b 2 2"],
    targets: Float[np.ndarray, "b 2 2"],
    margin: float,
) -> Float[np.ndarray, "b 2 2"]:
    """For each block with each target the farthest that the pusher gets beyond the border, in [m]; 0 if never.

    A place outside of the field, where a block may be thrown, is as far beyond the border as the field's nearest place
    and then the way from there.

    Args:
        distance: Signed distance to the border, in [m].
        blocks: Centres, world frame, in [m].
        targets: Centres, likewise.
        margin: How far inside of the border the pusher is to stay, in [m].
    """
    way = targets[:, None] - blocks[:, :, None]  # (b, block, target, 2)
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    heading = way / np.maximum(length, 1e-9)
    pushed = np.linspace(0, 1, POINTS) * np.maximum(length - PLACED, 0)  # (b, block, target, points)
    along = np.concatenate([np.full_like(length, -APPROACH), pushed - CONTACT], axis=-1)
    points = BLOCK_PUSH_SPACE.steps.positions(blocks[:, :, None, None] + along[..., None] * heading[..., None, :])
    nearest = points.clip(*(np.array([axis[end] for axis in distance.grid.axes()]) for end in (0, -1)))
    outside, _ = distance.value_and_gradient(nearest.reshape(-1, 3))
    beyond = outside.reshape(along.shape) + np.linalg.norm(points - nearest, axis=-1)
    return np.maximum(beyond.max(-1) + margin, 0)
