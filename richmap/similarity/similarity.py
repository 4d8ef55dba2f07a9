"""How alike two robots' approach directions are, cell by cell: maximum mean discrepancy with a multi-scale kernel."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import eval_legendre, roots_legendre

from richmap.geometry.grid import Grid, GridMismatchError
from richmap.geometry.harmonics import mean_harmonics
from richmap.maps.reachability_map import ReachabilityMap

SCALES = 5
"""Number of kernel widths (the paper's M)."""
DEGREE = 16
"""Degree at which spherical harmonics are cut off; the kernel's share beyond it is below 1e-5."""


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
    means = mean_harmonics(cells, robot_map.start, robot_map.directions, DEGREE)
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
    check_coincide(a.grid, b.grid, base, (a.robot, b.robot))
    weights = kernel_spectrum(scales)
    _, rows_a, rows_b = np.intersect1d(a.cells, b.cells, assume_unique=True, return_indices=True)
    mmd, one_sided = np.full(a.grid.n_cells, np.nan), np.full(a.grid.n_cells, np.nan)
    mmd[a.cells[rows_a]] = np.sqrt((a.means[rows_a] - b.means[rows_b]) ** 2 @ weights)
    filled_a, filled_b = (np.bincount(x.cells, minlength=a.grid.n_cells) > 0 for x in (a, b))
    for moments in (a, b):
        one_sided[moments.cells] = np.sqrt(moments.means**2 @ weights)
    one_sided[filled_a == filled_b] = np.nan
    return SimilarityGrid(a.grid, mmd, filled_a & ~filled_b, filled_b & ~filled_a, one_sided)


def check_coincide(source: Grid, target: Grid, base: tuple[float, float, float], robots: tuple[str, str]) -> None:
    """Raise `GridMismatchError` if the cells of a source's map and of a target's at a base do not coincide."""
    expected = source.moved(np.array(base))
    same = expected.cell_size == target.cell_size and expected.shape == target.shape
    if not same or not np.allclose(expected.origin, target.origin, atol=1e-9):
        raise GridMismatchError(
            f"With its base at {base} m, the map of {robots[1]} must have the grid {expected} to be "
            f"compared with {robots[0]}; it has {target}. Build it on that grid."
        )


def kernel_spectrum(scales: int = SCALES, degree: int = DEGREE) -> Float[np.ndarray, " harmonics"]:
    """Eigenvalue of the kernel for each spherical harmonic up to a degree; all of one degree share it (Funk-Hecke)."""
    node, weight = roots_legendre(200)
    degrees = np.arange(degree + 1)[:, None]
    spectrum = 2 * np.pi * (weight * kernel(node, scales) * eval_legendre(degrees, node)).sum(1)
    return np.repeat(np.maximum(spectrum, 0), 2 * np.arange(degree + 1) + 1)
