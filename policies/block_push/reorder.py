"""Of two blocks the one first that the arm can push: guidance by what the policy is shown."""

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
from jaxtyping import Float
from torch import Tensor

from policies.block_push.push_reach import overreach
from policies.flange_path import FlangePath
from policies.guidance import Guidance
from policies.guidance_methods import Projection
from policies.setup import Setup
from richmap.similarity.signed_distance import SignedDistanceField
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE, PLACED

STATE, SCENE = BLOCK_PUSH_SPACE.state, BLOCK_PUSH_SPACE.environment
BLOCKS, TARGETS = (
    [slice(SCENE[name].start, SCENE[name].start + 2) for name in names]
    for names in (("block", "block2"), ("target", "target2"))
)
"""Where their xy are in a scene."""
INSIDE = 0.00125
"""How far inside the border commands are kept, in [m]: what was chosen for `projection` alone."""


class Reorder(Guidance):
    """Leaves for later what the arm cannot push: the policy is shown that block as if it were in its target already.

    Of the two ways to give each block a target, the one whose straight pushes lead the pusher less far beyond what the
    arm can hold; of its two pushes the one that does so less, or, of equals, that of the block nearer to the effector.
    Scenes in which all pushes can be made, or in which a block is placed, are shown as they are.

    Args:
        distance: Signed distance to the border, in [m].
        margin: How far inside of the border the pusher is to stay, in [m].
        among: Gives that distance among obstacles at some places, which the arm then cannot hold its tool near to.
    """

    def __init__(
        self,
        distance: SignedDistanceField,
        margin: float,
        among: Callable[[Float[np.ndarray, "k 4"]], SignedDistanceField] | None = None,
    ) -> None:
        self.distance, self.margin, self.among = distance, margin, among
        self._distances: dict[int, SignedDistanceField] = {}

    def reset(self, rows: Sequence[int] | None) -> None:
        for row in [*self._distances] if rows is None else rows:
            self._distances.pop(row, None)

    def meet(self, rows: Sequence[int], places: Float[np.ndarray, "rows k 4"]) -> None:
        if self.among is not None:
            self._distances |= {row: self.among(at) for row, at in zip(rows, places, strict=True)}

    def imagine(self, environment: Float[Tensor, "b t 12"], state: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 12"]:
        scene = environment[:, -1].double().cpu().numpy()
        blocks, targets = (np.stack([scene[:, at] for at in which], 1) for which in (BLOCKS, TARGETS))
        cost = overreach(self.distance, blocks, targets, self.margin)  # (b, block, target)
        for row, among in self._distances.items():
            cost[row] = overreach(among, blocks[row, None], targets[row, None], self.margin)[0]
        placed = np.linalg.norm(blocks[:, :, None] - targets[:, None], axis=-1).min((1, 2)) < PLACED
        far = np.linalg.norm(blocks - state[:, None, STATE["effector"]].double().cpu().numpy(), axis=-1)
        shown = environment.clone()
        for row in np.flatnonzero(~placed & (cost > 0).any((1, 2))):
            crossed = int(np.trace(cost[row]) > np.trace(cost[row, ::-1]))
            pairs = [(block, block ^ crossed) for block in (0, 1)]
            _, _, later = max((cost[row][pair], far[row, pair[0]], pair) for pair in pairs)
            block, target = later
            shown[row, :, BLOCKS[block]] = environment[row, :, TARGETS[target]]
        return shown


@final
class KeptReorder(Reorder):
    """The same, and commands are kept inside of what the arm can hold, also among obstacles."""

    path = FlangePath(BLOCK_PUSH_SPACE)

    def correct(
        self, chunk: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        kept, others = chunk.clone(), [row for row in range(len(chunk)) if row not in self._distances]
        for rows, distance in [(others, self.distance), *(([row], at) for row, at in self._distances.items())]:
            kept[rows] = Projection(distance, INSIDE, self.path).correct(chunk[rows], state[rows])
        return kept


def reorder(given: Setup) -> Reorder:
    """What the arm cannot push is left for later."""
    return Reorder(given.field, given.scale, given.among)


def reorder_kept(given: Setup) -> KeptReorder:
    """And commands are kept inside of what the arm can hold."""
    return KeptReorder(given.field, given.scale, given.among)
