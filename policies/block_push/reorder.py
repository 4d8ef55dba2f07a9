"""Reorder."""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from policies.block_push.push_reach import PLACED, overreach
from policies.guidance import FLANGE_HEIGHT, Guidance
from richmap.similarity.signed_distance import SignedDistanceField


class Reorder(Guidance):
    """Leaves for later what the arm cannot push: the policy is shown that block as if it were in its target already.

    Of the two ways to give each block a target, the one whose straight pushes lead the pusher less far beyond what the
    arm can hold; of its two pushes the one that does so less, or, of equals, that of the block nearer to the effector.
    Scenes in which all pushes can be made, or in which a block is placed, are shown as they are.

    Args:
        distance: Signed distance to the border, in [m].
        margin: How far inside of the border the pusher is to stay, in [m].
    """

    def __init__(self, distance: SignedDistanceField, margin: float) -> None:
        self.distance, self.margin = distance, margin

    def imagine(self, environment: Float[Tensor, "b t 12"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 12"]:
        objects = environment[:, -1].unflatten(1, (4, 3))[..., :2].double().cpu().numpy()
        blocks, targets = objects[:, :2], objects[:, 2:]
        cost = overreach(self.distance, blocks, targets, self.margin, FLANGE_HEIGHT)  # (b, block, target)
        placed = np.linalg.norm(blocks[:, :, None] - targets[:, None], axis=-1).min((1, 2)) < PLACED
        far = np.linalg.norm(blocks - effector[:, None, :2].double().cpu().numpy(), axis=-1)
        shown = environment.clone()
        for row in np.flatnonzero(~placed & (cost > 0).any((1, 2))):
            crossed = int(np.trace(cost[row]) > np.trace(cost[row, ::-1]))
            pairs = [(block, block ^ crossed) for block in (0, 1)]
            _, _, later = max((cost[row][pair], far[row, pair[0]], pair) for pair in pairs)
            block, target = later
            shown[row, :, 3 * block : 3 * block + 2] = environment[row, :, 6 + 3 * target : 8 + 3 * target]
        return shown
