"""Bins of the unit sphere: small enough that one stored direction fills a bin, few enough to look at the neighbours."""

from functools import lru_cache
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int


def capacity_bound(theta: float) -> float:
    """Upper bound on directions with mutual separation `theta`, in [rad] (RichMap, Eq. 6)."""
    return 2 / (1 - np.cos(theta / 2))


@lru_cache
def bins_per_edge(theta: float) -> int:
    """Least number of bins along a cube face's edge for which no bin is as wide as `theta`, in [rad]."""
    n = int(np.ceil(np.pi / 2 / theta))
    while _widest_bin(n) >= theta:
        n += 1
    return n


@lru_cache
def neighbour_bins(theta: float) -> tuple[Int[np.ndarray, " bins1"], Int[np.ndarray, " pairs"]]:
    """For each bin the other bins that may hold a direction closer than `theta`, in [rad].

    Returns:
        Offsets and concatenated neighbour lists: those of bin b are `lists[offsets[b] : offsets[b + 1]]`.
    """
    n = bins_per_edge(theta)
    corners = _corners(n)
    centre = corners.mean(1)
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    radius = np.arccos(np.clip(np.einsum("bki,bi->bk", corners, centre), -1, 1)).max(1)
    offsets, lists = [0], []
    for b in range(len(centre)):
        angle = np.arccos(np.clip(centre @ centre[b], -1, 1))
        near = np.flatnonzero(angle < theta + radius + radius[b] + 1e-6)
        near = near[near != b]
        near = near[np.argsort(angle[near], kind="stable")]
        lists.append(near)
        offsets.append(offsets[-1] + len(near))
    return np.array(offsets, dtype=np.int32), np.concatenate(lists).astype(np.int32)


@numba.njit(cache=True, inline="always")
@no_type_check
def bin_of(x, y, z, n):
    """Bin of a unit vector: a face of the cube and a cell of that face, equally spaced in angle."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, u, v = (0 if x > 0 else 1), y / ax, z / ax
    elif ay >= az:
        face, u, v = (2 if y > 0 else 3), x / ay, z / ay
    else:
        face, u, v = (4 if z > 0 else 5), x / az, y / az
    i = min(int((np.arctan(u) * (4 / np.pi) + 1) * 0.5 * n), n - 1)
    j = min(int((np.arctan(v) * (4 / np.pi) + 1) * 0.5 * n), n - 1)
    return (face * n + i) * n + j


def _corners(n: int) -> Float[np.ndarray, "bins 4 3"]:
    """Corners of all bins as unit vectors, in the order of `bin_of`."""
    edge = np.tan(np.pi / 4 * np.linspace(-1, 1, n + 1))
    u, v = np.meshgrid(edge, edge, indexing="ij")
    one = np.ones_like(u)
    faces = [(one, u, v), (-one, u, v), (u, one, v), (u, -one, v), (u, v, one), (u, v, -one)]
    grid = np.stack([np.stack(face, -1) for face in faces])
    grid /= np.linalg.norm(grid, axis=-1, keepdims=True)
    quads = [grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, :-1, 1:], grid[:, 1:, 1:]]
    return np.stack(quads, axis=3).reshape(-1, 4, 3)


def _widest_bin(n: int) -> float:
    corners = _corners(n)
    cosine = np.einsum("bki,bli->bkl", corners, corners)
    return float(np.arccos(np.clip(cosine, -1, 1)).max())
