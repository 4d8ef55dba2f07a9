"""Compression of a map to one number per cell: the fraction of the sphere that its directions cover."""

from collections.abc import Iterator
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int

from richmap.geometry.directions import ROUNDING
from richmap.maps.reachability_map import ReachabilityMap

BLOCK = 4096
"""Cells whose covered directions are in memory at once."""


def fibonacci_lattice(samples: int) -> Float[np.ndarray, "samples 3"]:
    """Quasi-uniform unit vectors, each for an equal part of the sphere, from the pole +z downwards.

    The k-th has z = 1 - (2 k + 1) / samples and lies a golden angle farther about z than the one before (González,
    "Measurement of areas on a sphere using Fibonacci and latitude-longitude lattices", 2010).
    """
    k = np.arange(samples)
    z = 1 - (2 * k + 1) / samples
    angle = np.pi * (3 - np.sqrt(5)) * k
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def coverage_fraction(robot_map: ReachabilityMap, samples: int = 1000) -> Float[np.ndarray, "nx ny nz"]:
    """Fraction of directions that each cell reaches (RichMap, "Map Compression").

    Args:
        robot_map: The map.
        samples: Points of the Fibonacci lattice; the fractions are multiples of one over this number.

    Returns:
        Share of the lattice's points that are closer than theta to a stored direction, in float32, from 0 to 1.
    """
    fractions = np.zeros(robot_map.grid.n_cells, dtype=np.float32)
    for cells, covered in covered_directions(robot_map, fibonacci_lattice(samples)):
        fractions[cells] = covered.sum(1) / samples
    return fractions.reshape(robot_map.grid.shape)


def covered_directions(
    robot_map: ReachabilityMap, asked: Float[np.ndarray, "samples 3"]
) -> Iterator[tuple[Int[np.ndarray, " block"], Bool[np.ndarray, "block samples"]]]:
    """Which of some unit vectors, in falling order of z, are closer than theta to a stored direction.

    Returns:
        Blocks of filled cells, as flat indices, and the answers of each.
    """
    filled = np.flatnonzero(np.diff(robot_map.start))
    asked, theta = asked.astype(np.float32), robot_map.construction.theta
    for first in range(0, len(filled), BLOCK):
        cells = filled[first : first + BLOCK]
        yield cells, _covered(cells, robot_map.start, robot_map.directions, asked, theta)


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _covered(cells, start, directions, asked, theta):
    """The vectors near a direction are some between two rows, as they descend in z."""
    covered = np.zeros((len(cells), len(asked)), dtype=np.bool_)
    cosine, falling = np.float32(np.cos(theta)), -asked[:, 2].copy()
    for i in numba.prange(len(cells)):
        for row in range(start[cells[i]], start[cells[i] + 1]):
            x, y, z = directions[row]
            polar = np.arccos(min(max(z, -1.0), 1.0))
            first = np.searchsorted(falling, -np.cos(max(polar - theta, 0.0)) - ROUNDING)
            last = np.searchsorted(falling, -np.cos(min(polar + theta, np.pi)) + ROUNDING)
            for k in range(first, last):
                if asked[k, 0] * x + asked[k, 1] * y + asked[k, 2] * z > cosine:
                    covered[i, k] = True
    return covered
