"""Real spherical harmonics, orthonormal on the sphere; that of degree l and order m is number l^2 + l + m."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int

LANES = 32
"""Directions that go through the recurrence of the harmonics side by side."""


class Recurrence(NamedTuple):
    """Three-term recurrence of normalised associated Legendre functions, without their power of the sine."""

    a: Float[np.ndarray, "d d"]
    b: Float[np.ndarray, "d d"]
    diagonal: Float[np.ndarray, " d"]
    """The functions whose degree is their order, where the recurrence begins."""


def recurrence(degree: int) -> Recurrence:
    """Coefficients up to a degree (Holmes & Featherstone)."""
    l, m = np.meshgrid(np.arange(degree + 1.0), np.arange(degree + 1.0), indexing="ij")  # noqa: E741
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.sqrt((4 * l**2 - 1) / (l**2 - m**2))
        b = np.sqrt(((l - 1) ** 2 - m**2) / (4 * (l - 1) ** 2 - 1))
    k = np.arange(1, degree + 1)
    diagonal = np.concatenate([[np.sqrt(1 / (4 * np.pi))], np.sqrt((2 * k + 1) / (2 * k))]).cumprod()
    return Recurrence(np.nan_to_num(a, posinf=0), np.nan_to_num(b), diagonal)


def harmonics(directions: Float[np.ndarray, "n 3"], degree: int) -> Float[np.ndarray, "n harmonics"]:
    """All harmonics up to a degree at unit vectors."""
    rows = np.arange(len(directions) + 1)
    return mean_harmonics(rows[:-1], rows, np.ascontiguousarray(directions), degree)


def mean_harmonics(
    cells: Int[np.ndarray, " filled"],
    start: Int[np.ndarray, " cells1"],
    directions: Float[np.ndarray, "n 3"],
    degree: int,
) -> Float[np.ndarray, "filled harmonics"]:
    """Means of all harmonics up to a degree over the directions of cells, rows `start[c]` to `start[c + 1]`."""
    return _mean_harmonics(cells, start, directions, *recurrence(degree))


@numba.njit(cache=True, parallel=True, fastmath=True)
@no_type_check
def _mean_harmonics(cells, start, directions, a, b, diagonal):
    degree = len(diagonal) - 1
    means = np.zeros((len(cells), (degree + 1) ** 2), dtype=np.float32)
    for c in numba.prange(len(cells)):
        first, last = start[cells[c]], start[cells[c] + 1]
        total = np.zeros((degree + 1) ** 2)
        # Directions go through the recurrence side by side, in vector registers, with zeros after the last.
        x, y, z, real, imaginary, before, current = np.zeros((7, LANES))
        for row in range(first, last, LANES):
            count = min(LANES, last - row)
            real[:], imaginary[:] = 0, 0
            for i in range(count):
                x[i], y[i], z[i] = directions[row + i, 0], directions[row + i, 1], directions[row + i, 2]
                real[i] = 1  # of (x + iy)^m
            for m in range(degree + 1):
                before[:], current[:] = 0, diagonal[m]
                for l in range(m, degree + 1):  # noqa: E741
                    cosines, sines = 0.0, 0.0
                    for i in range(LANES):
                        if l > m:
                            new = a[l, m] * (z[i] * current[i] - b[l, m] * before[i])
                            before[i], current[i] = current[i], new
                        cosines += current[i] * real[i]
                        sines += current[i] * imaginary[i]
                    scale = 1.0 if m == 0 else np.sqrt(2.0)
                    total[l * l + l + m] += scale * cosines
                    if m > 0:
                        total[l * l + l - m] += scale * sines
                for i in range(LANES):
                    real[i], imaginary[i] = real[i] * x[i] - imaginary[i] * y[i], real[i] * y[i] + imaginary[i] * x[i]
        means[c] = total / (last - first)
    return means
