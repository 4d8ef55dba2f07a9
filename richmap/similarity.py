"""How alike two robots' approach directions are, cell by cell: maximum mean discrepancy with a multi-scale kernel."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import eval_legendre, roots_legendre

from richmap.grid import Grid, GridMismatchError
from richmap.reachability_map import ReachabilityMap

SCALES = 5
"""Number of kernel widths (the paper's M)."""
DEGREE = 16
"""Degree at which spherical harmonics are cut off; the kernel's share beyond it is below 1e-5."""


def kernel(cosine: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    r"""Multi-scale kernel of unit vectors u, v with this cosine (RichMap, "Robot similarity analysis").

    The mean over m of :math:`\exp(-\gamma_m \|u - v\|^2)` with :math:`\gamma_m = 2^{m - M/2}`.
    """
    gamma = 2.0 ** (np.arange(1, SCALES + 1) - SCALES / 2)
    return np.exp(-2 * gamma * (1 - np.asarray(cosine)[..., None])).mean(-1)


def mmd_squared(x: Float[np.ndarray, "n 3"], y: Float[np.ndarray, "m 3"]) -> float:
    """Squared MMD between two sets of unit directions by the sum over all pairs (RichMap, Eq. 8; V-statistic).

    Returns:
        Discrepancy, unitless, in [0, 2]; exactly 0 for equal sets.

    Raises:
        ValueError: If a set is empty.
    """
    if len(x) == 0 or len(y) == 0:
        raise ValueError(f"MMD needs directions on both sides. Got {len(x)} and {len(y)}.")
    return float(kernel(x @ x.T).mean() - 2 * kernel(x @ y.T).mean() + kernel(y @ y.T).mean())


@dataclass(frozen=True)
class SimilarityGrid:
    """Cell-wise discrepancy of two robots in the world frame, which is the source's base frame."""

    grid: Grid
    mmd: Float[np.ndarray, " cells"]
    """MMD (the root), unitless; NaN where not both robots have directions."""
    only_source: Bool[np.ndarray, " cells"]
    """Cells that only the source reaches."""
    only_target: Bool[np.ndarray, " cells"]
    """Cells that only the target reaches."""


@dataclass(frozen=True)
class DirectionMoments:
    """Mean spherical harmonics of each filled cell's directions, weighted so that MMD is their Euclidean distance."""

    cells: Int[np.ndarray, " filled"]
    moments: Float[np.ndarray, "filled features"]


def direction_moments(robot_map: ReachabilityMap) -> DirectionMoments:
    r"""Moments of every filled cell of a map; computed once per map, they serve every comparison.

    The kernel depends on the angle alone, so :math:`k(u, v) = \sum_l \lambda_l \sum_m Y_{lm}(u) Y_{lm}(v)` with
    real orthonormal harmonics, and the V-statistic is :math:`\sum_{lm} \lambda_l (\bar Y^x_{lm} - \bar Y^y_{lm})^2`.
    """
    cells = np.flatnonzero(np.diff(robot_map.start))
    weights = np.sqrt(_kernel_spectrum())
    moments = _mean_harmonics(cells, robot_map.start, robot_map.directions, *_recurrence(DEGREE))
    return DirectionMoments(cells, moments * np.repeat(weights, 2 * np.arange(DEGREE + 1) + 1))


def similarity(
    source: ReachabilityMap, target: ReachabilityMap, base: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> SimilarityGrid:
    """Compare two maps where their cells coincide in the world.

    Args:
        source: Map of the robot whose base frame is the world frame.
        target: Map of the other robot; its grid must be the source's seen from its base.
        base: Position of the target's base in the world, in [m].

    Raises:
        GridMismatchError: If the cells do not coincide.
    """
    expected = source.grid.moved(np.array(base))
    same = expected.cell_size == target.grid.cell_size and expected.shape == target.grid.shape
    if not same or not np.allclose(expected.origin, target.grid.origin, atol=1e-9):
        raise GridMismatchError(
            f"With its base at {base} m, the map of {target.construction.robot} must have the grid {expected} to be "
            f"compared with {source.construction.robot}; it has {target.grid}. Build it on that grid."
        )
    a, b = direction_moments(source), direction_moments(target)
    _, rows_a, rows_b = np.intersect1d(a.cells, b.cells, assume_unique=True, return_indices=True)
    mmd = np.full(source.grid.n_cells, np.nan)
    mmd[a.cells[rows_a]] = np.linalg.norm(a.moments[rows_a] - b.moments[rows_b], axis=1)
    filled_a, filled_b = np.diff(source.start) > 0, np.diff(target.start) > 0
    return SimilarityGrid(source.grid, mmd, filled_a & ~filled_b, filled_b & ~filled_a)


def _kernel_spectrum() -> Float[np.ndarray, " degrees"]:
    """Eigenvalue of the kernel for each degree of spherical harmonics (Funk-Hecke)."""
    node, weight = roots_legendre(200)
    degrees = np.arange(DEGREE + 1)[:, None]
    spectrum = 2 * np.pi * (weight * kernel(node) * eval_legendre(degrees, node)).sum(1)
    return np.maximum(spectrum, 0)


def _recurrence(
    degree: int,
) -> tuple[Float[np.ndarray, "d d"], Float[np.ndarray, "d d"], Float[np.ndarray, " d"]]:
    """Coefficients of the three-term recurrence of normalised associated Legendre functions (Holmes & Featherstone)."""
    l, m = np.meshgrid(np.arange(degree + 1.0), np.arange(degree + 1.0), indexing="ij")  # noqa: E741
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.sqrt((4 * l**2 - 1) / (l**2 - m**2))
        b = np.sqrt(((l - 1) ** 2 - m**2) / (4 * (l - 1) ** 2 - 1))
    k = np.arange(1, degree + 1)
    diagonal = np.concatenate([[np.sqrt(1 / (4 * np.pi))], np.sqrt((2 * k + 1) / (2 * k))]).cumprod()
    return np.nan_to_num(a, posinf=0), np.nan_to_num(b), diagonal


@numba.njit(cache=True, parallel=True)
@no_type_check
def _mean_harmonics(cells, start, directions, a, b, diagonal):
    degree = len(diagonal) - 1
    means = np.zeros((len(cells), (degree + 1) ** 2))
    for c in numba.prange(len(cells)):
        total = means[c]
        first, last = start[cells[c]], start[cells[c] + 1]
        for row in range(first, last):
            x, y, z = float(directions[row, 0]), float(directions[row, 1]), float(directions[row, 2])
            real, imaginary = 1.0, 0.0  # of (x + iy)^m
            for m in range(degree + 1):
                before, current = 0.0, diagonal[m]
                scale = 1.0 if m == 0 else np.sqrt(2.0)
                for l in range(m, degree + 1):  # noqa: E741
                    if l > m:
                        before, current = current, a[l, m] * (z * current - b[l, m] * before)
                    total[l * l + l + m] += scale * current * real
                    if m > 0:
                        total[l * l + l - m] += scale * current * imaginary
                real, imaginary = real * x - imaginary * y, real * y + imaginary * x
        total /= last - first
    return means
