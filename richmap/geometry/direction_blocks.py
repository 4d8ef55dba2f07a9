"""Blocks of the sphere by which a cell's directions are sorted, and what is near what."""

from functools import lru_cache
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, UInt

from richmap.geometry.directions import Lists, bin_corners, bin_of

BLOCKS_PER_EDGE = 6
"""Blocks of directions along an edge of a cube's face: two or three directions in each, in a full cell at 0.1 rad."""

BLOCKS = 6 * BLOCKS_PER_EDGE**2

BINS_PER_EDGE = 4 * BLOCKS_PER_EDGE
"""Bins of queries along an edge of a cube's face: of each bin is known which blocks lie within some angle of it."""


class Outwards(NamedTuple):
    """Where blocks are and how far apart."""

    centre: Float[np.ndarray, "blocks 3"]
    """Unit vectors to the blocks' centres."""
    cosine: np.float32
    sine: np.float32
    """Of the angle within which a block lies about its centre."""
    order: UInt[np.ndarray, "blocks blocks"]
    """For each block all blocks, the ones that may hold the nearest directions first."""
    limit: Float[np.ndarray, "blocks blocks"]
    """The greatest cosine between directions of the two."""


def block_of(directions: Float[np.ndarray, "n 3"]) -> UInt[np.ndarray, " n"]:
    """Block of each unit vector: rows of a map that are sorted by cell and by this need no copy in the index."""
    return _block_of_each(directions)


@lru_cache
def runs_within(angle: float) -> Lists:
    """For each bin the runs of blocks that may hold a direction within `angle`, in [rad], of one in it.

    Returns:
        Lists of runs: first block and end.
    """
    centre, radius = _cones(BINS_PER_EDGE)
    block = _block_of_each(centre.astype(np.float32))
    reach = np.cos(np.minimum(angle + radius[:, None] + radius, np.pi))
    near = np.zeros((len(centre), BLOCKS + 2), dtype=np.int8)
    for bin_, block_ in enumerate(block):
        near[:, block_ + 1] |= centre @ centre[bin_] > reach[:, bin_]
    of, first = np.nonzero(np.diff(near) > 0)
    _, end = np.nonzero(np.diff(near) < 0)
    offsets = np.searchsorted(of, np.arange(len(centre) + 1))
    return Lists(offsets.astype(np.int32), np.stack([first, end], 1).astype(np.uint8))


@lru_cache
def blocks_outwards() -> Outwards:
    """Blocks from each block outwards."""
    centre, radius = _cones(BLOCKS_PER_EDGE)
    radius = radius.max()
    angle = np.arccos(np.clip(centre @ centre.T, -1, 1))
    np.fill_diagonal(angle, -1)
    order = np.argsort(angle, axis=1, kind="stable")
    least = np.maximum(np.take_along_axis(angle, order, 1) - 2 * radius, 0)
    as_float = np.float32
    return Outwards(
        centre.astype(as_float),
        as_float(np.cos(radius)),
        as_float(np.sin(radius)),
        order.astype(np.uint8),
        (np.cos(least) + 1e-6).astype(as_float),
    )


def _cones(n: int) -> tuple[Float[np.ndarray, "bins 3"], Float[np.ndarray, " bins"]]:
    """Unit vectors to the centres of bins, and the angle within which each bin lies about its centre, in [rad]."""
    corners = bin_corners(n)
    centre = corners.mean(1)
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    slack = 1e-4  # for rounding
    return centre, np.arccos(np.einsum("bki,bi->bk", corners, centre)).max(1) + slack


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _block_of_each(directions):
    block = np.empty(len(directions), dtype=np.uint8)
    for i in numba.prange(len(directions)):
        x, y, z = directions[i]
        block[i] = bin_of(x, y, z, BLOCKS_PER_EDGE)
    return block
