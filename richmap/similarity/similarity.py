"""How alike two robots' approach directions are, cell by cell: maximum mean discrepancy with a multi-scale kernel."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import eval_legendre, roots_legendre

from richmap.geometry.grid import Grid, GridMismatchError
from richmap.maps.reachability_map import ReachabilityMap

SCALES = 5
"""Number of kernel widths (the paper's M)."""
DEGREE = 16
"""Degree at which spherical harmonics are cut off; the kernel's share beyond it is below 1e-5."""

LANES = 32
"""Directions that go through the recurrence of the harmonics side by side."""


def kernel(cosine: Float[np.ndarray, "*shape"], scales: int = SCALES) -> Float[np.ndarray, "*shape"]:
    r"""Multi-scale kernel of unit vectors u, v with this cosine (RichMap, "Robot similarity analysis").

    The mean over m of :math:`\exp(-\gamma_m \|u - v\|^2)` with :math:`\gamma_m = 2^{m - M/2}`, M being `scales`.
    """
    gamma = 2.0 ** (np.arange(1, scales + 1) - scales / 2)
    return np.exp(-2 * gamma * (1 - np.asarray(cosine)[..., None])).mean(-1)


def mmd_squared(x: Float[np.ndarray, "n 3"], y: Float[np.ndarray, "m 3"], scales: int = SCALES) -> float:
    """Squared MMD between two sets of unit directions by the sum over all pairs (RichMap, Eq. 8; V-statistic).

    Returns:
        Discrepancy, unitless, in [0, 2]; exactly 0 for equal sets.

    Raises:
        ValueError: If a set is empty.
    """
    if len(x) == 0 or len(y) == 0:
        raise ValueError(f"MMD needs directions on both sides. Got {len(x)} and {len(y)}.")
    xx, xy, yy = (kernel(cosine, scales).mean() for cosine in (x @ x.T, x @ y.T, y @ y.T))
    return float(xx - 2 * xy + yy)


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
    one_sided: Float[np.ndarray, " cells"]
    """Discrepancy from an empty set, whose expectations are 0, in those two kinds of cells; NaN elsewhere."""


@dataclass(frozen=True)
class DirectionMoments:
    """Mean spherical harmonics of each filled cell's directions: all that comparisons need to know of a map."""

    robot: str
    grid: Grid
    """In the robot's base frame."""
    cells: Int[np.ndarray, " filled"]
    means: Float[np.ndarray, "filled harmonics"]


def direction_moments(robot_map: ReachabilityMap) -> DirectionMoments:
    """Moments of every filled cell of a map; computed once per map, they serve every comparison."""
    cells = np.flatnonzero(np.diff(robot_map.start))
    means = _mean_harmonics(cells, robot_map.start, robot_map.directions, *_recurrence(DEGREE))
    return DirectionMoments(robot_map.construction.robot, robot_map.grid, cells, means)


def compare_maps(
    source: ReachabilityMap | DirectionMoments,
    target: ReachabilityMap | DirectionMoments,
    base: tuple[float, float, float] = (0.0, 0.0, 0.0),
    scales: int = SCALES,
) -> SimilarityGrid:
    r"""Compare two maps where their cells coincide in the world.

    The kernel depends on the angle alone, so :math:`k(u, v) = \sum_l \lambda_l \sum_m Y_{lm}(u) Y_{lm}(v)` with
    real orthonormal harmonics, and the V-statistic is :math:`\sum_{lm} \lambda_l (\bar Y^x_{lm} - \bar Y^y_{lm})^2`.

    Args:
        source: Map of the robot whose base frame is the world frame, or its moments, if it is compared more than once.
        target: Map or moments of the other robot; its grid must be the source's seen from its base.
        base: Position of the target's base in the world, in [m].
        scales: Number of kernel widths (the paper's M). Harmonics up to `DEGREE` serve up to 7.

    Raises:
        GridMismatchError: If the cells do not coincide.
    """
    a, b = (x if isinstance(x, DirectionMoments) else direction_moments(x) for x in (source, target))
    expected = a.grid.moved(np.array(base))
    same = expected.cell_size == b.grid.cell_size and expected.shape == b.grid.shape
    if not same or not np.allclose(expected.origin, b.grid.origin, atol=1e-9):
        raise GridMismatchError(
            f"With its base at {base} m, the map of {b.robot} must have the grid {expected} to be "
            f"compared with {a.robot}; it has {b.grid}. Build it on that grid."
        )
    weights = np.repeat(_kernel_spectrum(scales), 2 * np.arange(DEGREE + 1) + 1)
    _, rows_a, rows_b = np.intersect1d(a.cells, b.cells, assume_unique=True, return_indices=True)
    mmd, one_sided = np.full(a.grid.n_cells, np.nan), np.full(a.grid.n_cells, np.nan)
    mmd[a.cells[rows_a]] = np.sqrt((a.means[rows_a] - b.means[rows_b]) ** 2 @ weights)
    filled_a, filled_b = (np.bincount(x.cells, minlength=a.grid.n_cells) > 0 for x in (a, b))
    for moments in (a, b):
        one_sided[moments.cells] = np.sqrt(moments.means**2 @ weights)
    one_sided[filled_a == filled_b] = np.nan
    return SimilarityGrid(a.grid, mmd, filled_a & ~filled_b, filled_b & ~filled_a, one_sided)


def _kernel_spectrum(scales: int) -> Float[np.ndarray, " degrees"]:
    """Eigenvalue of the kernel for each degree of spherical harmonics (Funk-Hecke)."""
    node, weight = roots_legendre(200)
    degrees = np.arange(DEGREE + 1)[:, None]
    spectrum = 2 * np.pi * (weight * kernel(node, scales) * eval_legendre(degrees, node)).sum(1)
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
