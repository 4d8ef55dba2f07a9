"""Directions on the unit sphere: bins that hold at most one stored direction, and a code of four bytes within a bin."""

from functools import lru_cache
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int, Shaped

WARP = 0.273
"""Faces of the cube are divided evenly in u (1 + WARP (1 - |u|)), within 0.3 degrees of even angles and cheap."""

ROUNDING = 3e-7
"""Cosines are computed in float32; with this much less than that of theta, none stored is nearer in truth."""

CODE_STEPS = 65534
"""Steps in which a coordinate from -1 to 1 on a cube's face is coded; a direction moves by less than 2e-5 rad."""


class Lists(NamedTuple):
    """Lists of different lengths, one after another: the one of bin b is `lists[offsets[b] : offsets[b + 1]]`."""

    offsets: Int[np.ndarray, " bins1"]
    lists: Shaped[np.ndarray, "n ..."]


def capacity_bound(theta: float) -> float:
    """Upper bound on directions with mutual separation `theta`, in [rad] (RichMap, Eq. 6)."""
    return 2 / (1 - np.cos(theta / 2))


@lru_cache
def bins_per_edge(theta: float) -> int:
    """Least number of bins along a cube face's edge for which no bin is as wide as `theta`, in [rad]."""
    n = int(np.ceil(np.pi / 2 / theta))
    while _widest_bin(n) >= theta - 1e-4:  # codes may move a direction over a bin's edge
        n += 1
    return n


@lru_cache
def neighbour_bins(theta: float) -> Lists:
    """For each bin the other bins that may hold a direction closer than `theta`, in [rad].

    Returns:
        Neighbour lists, nearest bins first.
    """
    n = bins_per_edge(theta)
    corners = bin_corners(n)
    centre = corners.mean(1)
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    radius = np.arccos(np.clip(np.einsum("bki,bi->bk", corners, centre), -1, 1)).max(1)
    offsets, lists = [0], []
    for b in range(len(centre)):
        angle = np.arccos(np.clip(centre @ centre[b], -1, 1))
        near = np.flatnonzero(angle < theta + radius + radius[b] + 1e-4)
        near = near[near != b]
        near = near[np.argsort(angle[near], kind="stable")]
        lists.append(near)
        offsets.append(offsets[-1] + len(near))
    return Lists(np.array(offsets, dtype=np.int32), np.concatenate(lists).astype(np.int32))


@numba.njit(cache=True, inline="always")
@no_type_check
def bin_of(x, y, z, n):
    """Bin of a unit vector: a face of the cube and a cell of that face."""
    face, u, v = face_of(x, y, z)
    return bin_on_face(face, u, v, n)


@numba.njit(cache=True, inline="always")
@no_type_check
def face_of(x, y, z):
    """Where the ray along a vector leaves the cube: number of the face, and two coordinates from -1 to 1 on it."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        return (0 if x > 0 else 1), y / ax, z / ax
    if ay >= az:
        return (2 if y > 0 else 3), x / ay, z / ay
    return (4 if z > 0 else 5), x / az, y / az


@numba.njit(cache=True, inline="always")
@no_type_check
def bin_on_face(face, u, v, n):
    """Bin that holds a point of a face."""
    i = max(min(int((u * (1 + WARP * (1 - abs(u))) + 1) * 0.5 * n), n - 1), 0)  # also where u is not a number
    j = max(min(int((v * (1 + WARP * (1 - abs(v))) + 1) * 0.5 * n), n - 1), 0)
    return (face * n + i) * n + j


@numba.njit(cache=True, inline="always")
@no_type_check
def code_of(u, v):
    """Two coordinates from -1 to 1 as one 32-bit number above 0."""
    a = int((u + 1) * (0.5 * CODE_STEPS) + 0.5) + 1
    b = int((v + 1) * (0.5 * CODE_STEPS) + 0.5) + 1
    return np.uint32((a << 16) | b)


@numba.njit(cache=True, inline="always")
@no_type_check
def decode(face, code):
    """Unit vector, in float32, of a code on a face."""
    u = np.float32(np.int32(code >> np.uint32(16)) - 1) * np.float32(2 / CODE_STEPS) - np.float32(1)
    v = np.float32(np.int32(code & np.uint32(0xFFFF)) - 1) * np.float32(2 / CODE_STEPS) - np.float32(1)
    w = np.float32(1) / np.sqrt(np.float32(1) + u * u + v * v)
    u, v = u * w, v * w
    if face == 0:
        return w, u, v
    if face == 1:
        return -w, u, v
    if face == 2:
        return u, w, v
    if face == 3:
        return u, -w, v
    if face == 4:
        return u, v, w
    return u, v, -w


def bin_corners(n: int) -> Float[np.ndarray, "bins 4 3"]:
    """Corners of all bins as unit vectors, in the order of `bin_of`."""
    even = np.linspace(-1, 1, n + 1)
    edge = np.sign(even) * (1 + WARP - np.sqrt((1 + WARP) ** 2 - 4 * WARP * np.abs(even))) / (2 * WARP)
    u, v = np.meshgrid(edge, edge, indexing="ij")
    one = np.ones_like(u)
    faces = [(one, u, v), (-one, u, v), (u, one, v), (u, -one, v), (u, v, one), (u, v, -one)]
    grid = np.stack([np.stack(face, -1) for face in faces])
    grid /= np.linalg.norm(grid, axis=-1, keepdims=True)
    quads = [grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, :-1, 1:], grid[:, 1:, 1:]]
    return np.stack(quads, axis=3).reshape(-1, 4, 3)


def _widest_bin(n: int) -> float:
    corners = bin_corners(n)
    cosine = np.einsum("bki,bli->bkl", corners, corners)
    return float(np.arccos(np.clip(cosine, -1, 1)).max())
