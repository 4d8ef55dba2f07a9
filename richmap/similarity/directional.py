"""Similarity and reach over positions and approach directions: the witness of the discrepancy, coverage, distance."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt
from scipy.special import roots_legendre

from richmap.geometry.grid import Grid
from richmap.geometry.harmonics import harmonics, mean_harmonics
from richmap.maps.compression import covered_directions, fibonacci_lattice
from richmap.maps.reachability_map import ReachabilityMap
from richmap.similarity.directional_field import DirectionalField, smoothed
from richmap.similarity.similarity import SCALES, check_coincide, kernel_spectrum

DEGREE = 10
"""Harmonics' degree at most; the kernel, which is 1 at angle 0, is off by 0.0013 at most, and by 2e-6 with 16."""
SMOOTHING = 1.0
"""Standard deviation of the Gaussian filter over position, in [cells], as `EnergySettings` has it."""
NORMALISATIONS = ("densities", "coverages")
"""Ways to weigh the directions of the two maps."""
SAMPLES = 2000
"""Points of the lattice on the sphere by which coverage is measured."""
NOWHERE = 0.3
"""Signed distances end here, in [m]: far from the border they say nothing, and harmonics cannot follow high steps."""


@final
@dataclass(frozen=True)
class DirectionalEnergy(DirectionalField):
    r"""How much more the source than the target has the approach direction v at the position p; unitless.

    It is the witness function of the discrepancy of a cell's two sets of directions, A and B (Gretton et al., JMLR
    2012, section 2.3), smooth over position: above 0 where the source has directions that the target lacks.

    - `densities`: :math:`E(v) = \frac{1}{|A|} \sum_{u \in A} k(u, v) - \frac{1}{|B|} \sum_{u \in B} k(u, v)`, with the
      kernel of `compare_maps`. Unsmoothed, with :math:`k_l` from `kernel_spectrum`, the cell's MMD^2 is
      :math:`\sum_{lm} c_{lm}^2 / k_l`. A target with few directions looks attractive along them, as they are few.
    - `coverages`: the source's `DirectionalCoverage` less the target's, from -1 to 1: zero where both reach.

    In a cell that one robot leaves empty its sum is 0.
    """

    KIND = "richmap.DirectionalEnergy"

    @property
    def unit(self) -> str:
        return "1"

    @classmethod
    def from_maps(
        cls,
        source: ReachabilityMap,
        target: ReachabilityMap,
        base: tuple[float, float, float] = (0.0, 0.0, 0.0),
        normalisation: str = "densities",
        scales: int = SCALES,
        degree: int = DEGREE,
        smoothing: float = SMOOTHING,
    ) -> "DirectionalEnergy":
        """The energy of two maps whose cells coincide in the world.

        Args:
            source: Map of the robot whose base frame is the world frame.
            target: Map of the other robot; its grid must be the source's seen from its base.
            base: Position of the target's base in the world, in [m].
            normalisation: `densities` or `coverages`.
            scales: Number of kernel widths (the paper's M).
            degree: Of the harmonics, at most.
            smoothing: Standard deviation of the Gaussian filter over position, in [cells].

        Raises:
            GridMismatchError: If the cells do not coincide.
            ValueError: If there is no such normalisation.
        """
        if normalisation not in NORMALISATIONS:
            raise ValueError(f"normalisation={normalisation!r} is none of {', '.join(NORMALISATIONS)}.")
        robots = source.construction.robot, target.construction.robot
        check_coincide(source.grid, target.grid, base, robots)
        moments = _density_moments if normalisation == "densities" else _coverage_moments
        difference = moments(source, degree) - moments(target, degree)
        difference *= _weights(normalisation, scales, degree)
        about = {"source": robots[0], "target": robots[1], "normalisation": normalisation, "scales": str(scales)}
        return cls(source.grid, smoothed(difference, smoothing), about)


@final
@dataclass(frozen=True)
class DirectionalCoverage(DirectionalField):
    r"""Share of the directions about v that an arm reaches at the position p, from 0 to 1; smooth in both.

    :math:`C(v) = \int_R k(u, v) du / \int k(u, v) du` over the directions R within theta of one that the cell stores,
    and over the whole sphere, with the kernel of `compare_maps`.
    """

    KIND = "richmap.DirectionalCoverage"

    @property
    def unit(self) -> str:
        return "1"

    @classmethod
    def from_map(
        cls,
        target: ReachabilityMap,
        base: tuple[float, float, float] = (0.0, 0.0, 0.0),
        scales: int = SCALES,
        degree: int = DEGREE,
        smoothing: float = SMOOTHING,
    ) -> "DirectionalCoverage":
        """The coverage of an arm with its base somewhere in the world, in [m]; see `DirectionalEnergy.from_maps`."""
        moments = _coverage_moments(target, degree) * _weights("coverages", scales, degree)
        about = {"target": target.construction.robot, "scales": str(scales)}
        return cls(target.grid.moved(-np.array(base)), smoothed(moments, smoothing), about)


@final
@dataclass(frozen=True)
class DirectionalDistance(DirectionalField):
    """Signed distance, in [m], from the position p to the border of where an arm reaches the approach direction v.

    It is above 0 where the arm does not reach v, and measured in position alone, at the same direction, up to 0.3 m.
    Harmonics round it off where it changes quickly with the direction: by some cm beside a step of the whole range.
    """

    KIND = "richmap.DirectionalDistance"

    @property
    def unit(self) -> str:
        return "m"

    @classmethod
    def from_map(
        cls,
        target: ReachabilityMap,
        base: tuple[float, float, float] = (0.0, 0.0, 0.0),
        degree: int = DEGREE,
        smoothing: float = SMOOTHING,
    ) -> "DirectionalDistance":
        """The distance of an arm with its base somewhere in the world, in [m]; see `DirectionalEnergy.from_maps`."""
        directions, weights = quadrature(degree)
        reached = np.zeros((target.grid.n_cells, len(directions)), dtype=bool)
        for cells, covered in covered_directions(target, directions):
            reached[cells] = covered
        distance = np.empty((len(directions), target.grid.n_cells), dtype=np.float32)
        for each, row in zip(reached.T, distance, strict=True):
            row[:] = _signed_distance(each.reshape(target.grid.shape), target.grid.cell_size).ravel()
        values = distance.T @ (weights[:, None] * harmonics(directions, degree)).astype(np.float32)
        about = {"target": target.construction.robot}
        shaped = values.reshape(*target.grid.shape, -1)
        return cls(target.grid.moved(-np.array(base)), smoothed(shaped, smoothing), about)


def quadrature(degree: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Directions, in falling order of z, and weights that integrate products of two harmonics up to a degree."""
    heights, weights = roots_legendre(degree + 1)
    turns = 2 * degree + 1
    angle = 2 * np.pi * np.arange(turns) / turns
    z, angle = np.repeat(heights[::-1], turns), np.tile(angle, degree + 1)
    radius = np.sqrt(1 - z**2)
    directions = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    return directions, np.repeat(weights[::-1], turns) * 2 * np.pi / turns


def _weights(normalisation: str, scales: int, degree: int) -> Float[np.ndarray, " harmonics"]:
    """What each harmonic of the directions counts: the kernel's spectrum, as a share of a full sphere in coverages."""
    spectrum = kernel_spectrum(scales, degree)
    return spectrum if normalisation == "densities" else spectrum / spectrum[0]


def _density_moments(robot_map: ReachabilityMap, degree: int) -> Float[np.ndarray, "nx ny nz harmonics"]:
    """Mean harmonics of each cell's stored directions; 0 in an empty cell."""
    cells = np.flatnonzero(np.diff(robot_map.start))
    return _at_cells(robot_map.grid, cells, mean_harmonics(cells, robot_map.start, robot_map.directions, degree))


def _coverage_moments(robot_map: ReachabilityMap, degree: int) -> Float[np.ndarray, "nx ny nz harmonics"]:
    """Integrals of the harmonics over the directions that each cell reaches; 0 in an empty cell."""
    lattice = fibonacci_lattice(SAMPLES)
    each = harmonics(lattice, degree).astype(np.float32) * np.float32(4 * np.pi / SAMPLES)
    blocks = [(cells, covered.astype(np.float32) @ each) for cells, covered in covered_directions(robot_map, lattice)]
    if not blocks:
        raise ValueError(f"The map of {robot_map.construction.robot} is empty.")
    cells, moments = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return _at_cells(robot_map.grid, cells, moments)


def _at_cells(grid: Grid, cells: np.ndarray, rows: np.ndarray) -> Float[np.ndarray, "nx ny nz harmonics"]:
    values = np.zeros((grid.n_cells, rows.shape[1]), dtype=np.float32)
    values[cells] = rows
    return values.reshape(*grid.shape, -1)


def _signed_distance(reached: Bool[np.ndarray, "nx ny nz"], cell_size: float) -> Float[np.ndarray, "nx ny nz"]:
    """From the cells' centres to the border, half a cell from either's centre; below 0 inside."""
    if not reached.any() or reached.all():
        return np.full(reached.shape, -NOWHERE if reached.all() else NOWHERE)
    outside, inside = distance_transform_edt(~reached) - 0.5, 0.5 - distance_transform_edt(reached)
    return np.clip(np.where(reached, inside, outside) * cell_size, -NOWHERE, NOWHERE)
