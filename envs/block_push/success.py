"""What counts as success, once: pure functions of where the blocks are."""

import numpy as np
from jaxtyping import Bool, Float

SUCCESS_RADIUS = 0.05
"""A block is in a target when their centres are closer than this, in [m]."""
FIRST_BLOCK, BOTH_BLOCKS = 0.49, 0.51
"""Reward for a block's entry into a target, and for both blocks in different targets; the shares of the
score."""


def inside(blocks: Float[np.ndarray, "*n 2 2"], targets: Float[np.ndarray, "*n 2 2"]) -> Bool[np.ndarray, "*n 2 2"]:
    """Which block (row) is in which target (column); xy in [m]."""
    offset = blocks[..., :, None, :] - targets[..., None, :, :]
    return np.sqrt((offset * offset).sum(-1)) < SUCCESS_RADIUS


def both_placed(now: Bool[np.ndarray, "2 2"]) -> bool:
    """Whether the blocks are in different targets."""
    return bool((now[0, 0] and now[1, 1]) or (now[0, 1] and now[1, 0]))


def rewards(before: Bool[np.ndarray, "2 2"], now: Bool[np.ndarray, "2 2"]) -> tuple[float, float]:
    """Reward for entries and for both blocks, of which one is zero: 0.49 for every block that enters a target
    it has not been in before, and instead of that 0.51 once both are placed.

    Args:
        before: Which block has been in which target before.
        now: Which block is in which target.
    """
    if both_placed(now):
        return 0.0, BOTH_BLOCKS
    return FIRST_BLOCK * int(np.count_nonzero(now & ~before)), 0.0


def score(p1: bool, p2: bool) -> float:
    """The original's score of an episode: 0, 0.49 or 1."""
    return round(FIRST_BLOCK * p1 + BOTH_BLOCKS * p2, 2)
