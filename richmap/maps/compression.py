"""Compression of a map to one number per cell: the fraction of the sphere that its directions cover."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float

from richmap.maps.reachability_map import ReachabilityMap


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
    lattice = fibonacci_lattice(samples).astype(np.float32)
    fractions = _covered(robot_map.start, robot_map.directions, lattice, robot_map.construction.theta) / samples
    return fractions.astype(np.float32).reshape(robot_map.grid.shape)


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _covered(start, directions, lattice, theta):
    """Number of lattice points that the directions of each cell cover.

    The lattice descends in z, so that the points near a direction are some between two of its rows.
    """
    covered = np.zeros(len(start) - 1, dtype=np.int64)
    cosine, n = np.float32(np.cos(theta)), len(lattice)
    for cell in numba.prange(len(covered)):
        seen = np.zeros(n, dtype=np.bool_)
        for row in range(start[cell], start[cell + 1]):
            x, y, z = directions[row]
            polar = np.arccos(min(max(z, -1.0), 1.0))
            highest, lowest = np.cos(max(polar - theta, 0.0)), np.cos(min(polar + theta, np.pi))
            first = max(int((1 - highest) / 2 * n - 1), 0)
            last = min(int((1 - lowest) / 2 * n + 1), n)
            for k in range(first, last):
                if lattice[k, 0] * x + lattice[k, 1] * y + lattice[k, 2] * z > cosine:
                    seen[k] = True
        covered[cell] = seen.sum()
    return covered
