"""How a block slides when a point pushes it: the quasi-static model of planar pushing.

Friction with the table makes motion and force proportional: a force through the block's centre moves it along the
force, and a moment turns it, scaled by `TURNING` (ellipsoidal limit surface; Lynch, Maekawa and Tanie, "Manipulation
and active sensing by pushing using tactile feedback", IROS 1992).
"""

import numpy as np
from jaxtyping import Bool, Float

HALF_EDGE, PUSHER_RADIUS = 0.02, 0.005
"""Of the block and of the pusher, in [m]."""
TURNING, FRICTION = 0.025, 0.5
"""Greatest moment over greatest force of the block's friction with the table, in [m], and friction between pusher and
block: fitted to 60 oblique pushes in the simulation, which they foretell to 1.6 mm and 2.6 degrees (rms, of 10 mm). The
simulation's own friction is 1, but its contacts creep."""


def push(
    pusher: Float[np.ndarray, "n 2"],
    block: Float[np.ndarray, "n 3"],
    step: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Where pushers and blocks are after a short step of each pusher, a few millimetres long.

    Args:
        pusher: Centres of the pushers, in [m].
        block: x, y in [m] and yaw in [rad] of the blocks.
        step: Of each pusher, in [m].

    Returns:
        Pushers and blocks afterwards, and which pushers touched their block.
    """
    after = pusher + step
    cosine, sine = np.cos(block[:, 2]), np.sin(block[:, 2])
    to_block = np.stack([np.stack([cosine, sine], 1), np.stack([-sine, cosine], 1)], 1)  # (n, 2, 2)
    local = np.einsum("nij,nj->ni", to_block, pusher - block[:, :2])
    # The face that the pusher is before: the one whose plane it is farthest outside of.
    axis = np.abs(local).argmax(1)
    rows = np.arange(len(local))
    side = np.sign(local[rows, axis])
    normal, tangent = np.zeros_like(local), np.zeros_like(local)
    normal[rows, axis] = -side  # Into the block.
    tangent[rows, 1 - axis] = 1.0
    moved = np.einsum("nij,nj->ni", to_block, after - block[:, :2])
    gap = -(moved * normal).sum(1) - HALF_EDGE - PUSHER_RADIUS
    lateral = (moved * tangent).sum(1)
    touching = (gap < 0) & (np.abs(lateral) <= HALF_EDGE)
    velocity = (moved - local) * np.clip(-gap / np.maximum(((moved - local) * normal).sum(1), 1e-9), 0, 1)[:, None]
    contact = -HALF_EDGE * normal + lateral[:, None] * tangent
    moving = _block_motion(contact, normal, tangent, velocity) * touching[:, None]
    shift = np.einsum("nji,nj->ni", to_block, moving[:, :2])
    return after, block + np.column_stack([shift, moving[:, 2]]), touching


def _block_motion(
    contact: Float[np.ndarray, "n 2"],
    normal: Float[np.ndarray, "n 2"],
    tangent: Float[np.ndarray, "n 2"],
    velocity: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 3"]:
    """Motion of the block's centre and its turn, where the contact point is pushed with this velocity; block frame."""
    arm = np.column_stack([-contact[:, 1], contact[:, 0]])  # Turn times this is the velocity of the contact point.
    compliance = np.eye(2) + arm[:, :, None] * arm[:, None, :] / TURNING**2
    force = np.linalg.solve(compliance, velocity[..., None])[..., 0]  # If the contact sticks.
    along, across = (force * normal).sum(1), (force * tangent).sum(1)
    slips = np.abs(across) > FRICTION * along
    edge = normal + FRICTION * np.sign(across)[:, None] * tangent
    answer = edge + (arm * edge).sum(1, keepdims=True) / TURNING**2 * arm
    size = (velocity * normal).sum(1) / np.maximum((answer * normal).sum(1), 1e-9)
    force = np.where(slips[:, None], np.maximum(size, 0)[:, None] * edge, force)
    return np.column_stack([force, (arm * force).sum(1) / TURNING**2])
