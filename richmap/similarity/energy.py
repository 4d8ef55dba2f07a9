"""From the similarity of two robots to a smooth energy field over the workspace."""

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, distance_transform_cdt, gaussian_filter

from richmap.files import load_arrays, save_arrays
from richmap.geometry.cubic_spline import CubicSpline
from richmap.geometry.grid import Grid
from richmap.similarity.energy_settings import EnergySettings
from richmap.similarity.similarity import SimilarityGrid

KIND, VERSION = "richmap.EnergyField", 1

SIX_NEIGHBOURS = np.zeros((3, 3, 3), dtype=bool)
SIX_NEIGHBOURS[[0, 2, 1, 1, 1, 1], [1, 1, 0, 2, 1, 1], [1, 1, 1, 1, 0, 2]] = True


@dataclass(frozen=True)
class EnergyField:
    """Smooth energy over the workspace in the world frame; low where the robots are alike (RichMap, Eqs. 9-10)."""

    grid: Grid
    values: Float[np.ndarray, "nx ny nz"]
    """Energy at the cells' centres, unitless."""
    about: dict[str, str]
    """What the field was made from, for provenance."""

    @classmethod
    def from_similarity(
        cls, similarity: SimilarityGrid, settings: EnergySettings, about: dict[str, str]
    ) -> "EnergyField":
        """Seeds, wavefront, smoothing."""
        energy = propagate(seed_cells(similarity, settings), settings.step)
        smooth = gaussian_filter(energy, settings.smoothing, mode="nearest")
        return cls(similarity.grid, smooth, about)

    def value_and_gradient(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Energy and its gradient, in [1/m], at points of the world frame, in [m].

        The field is the cubic B-spline through the cells' centres, so both are exact and continuous.

        Raises:
            ValueError: If a point lies outside the cells' centres.
        """
        result = self._spline.value_and_gradient(points)
        if np.isnan(result[:, 0]).any():
            lower, upper = np.array([axis[[0, -1]] for axis in self.grid.axes()]).T
            point = points[np.isnan(result[:, 0])][0]
            raise ValueError(f"{point} m is outside the energy field, from {lower} to {upper} m.")
        return result[:, 0], result[:, 1:]

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The gradient alone, which is all that guidance needs.

        Raises:
            ValueError: If a point lies outside the cells' centres.
        """
        return self.value_and_gradient(points)[1]

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline.through(self.grid.axes(), self.values)

    def save(self, path: Path) -> None:
        """Write the field as one safetensors file, atomically."""
        save_arrays(
            path,
            KIND,
            VERSION,
            {"values": self.values},
            {"grid": json.dumps(asdict(self.grid)), **self.about},
        )

    @classmethod
    def load(cls, path: Path) -> "EnergyField":
        """Read a field.

        Raises:
            FileRefusedError: If the file is cut short, is no field, or has another version.
        """
        arrays, about = load_arrays(path, KIND, VERSION)
        grid = Grid.from_dict(json.loads(about.pop("grid")))
        return cls(grid, arrays["values"], about)


def seed_cells(similarity: SimilarityGrid, settings: EnergySettings) -> Bool[np.ndarray, "nx ny nz"]:
    """Cells of zero energy: similar enough, outside the central region, not isolated (RichMap, Eq. 9).

    The threshold (the paper's tau) is the mean of the positive discrepancies.
    """
    discrepancy = similarity.mmd
    if settings.one_sided == "counted":
        discrepancy = np.where(np.isnan(discrepancy), similarity.one_sided, discrepancy)
    if settings.discrepancy == "mmd2":
        discrepancy = discrepancy**2
    positive = discrepancy[discrepancy > 0]
    threshold = positive.mean() if len(positive) else 0.0
    missing = 0.0 if settings.empty == "seed" else np.inf
    seeds = np.nan_to_num(discrepancy, nan=missing) <= threshold
    centres = similarity.grid.centres()
    seeds &= np.hypot(centres[:, 0], centres[:, 1]) >= settings.central_radius
    seeds = seeds.reshape(similarity.grid.shape)
    return seeds & binary_dilation(seeds, SIX_NEIGHBOURS)


def propagate(seeds: Bool[np.ndarray, "nx ny nz"], step: float) -> Float[np.ndarray, "nx ny nz"]:
    """Fill the grid layer by layer: the mean of the filled 6-neighbours plus `step` (RichMap, Eq. 10).

    Raises:
        ValueError: If there is no seed.
    """
    if not seeds.any():
        raise ValueError("The energy field has no seed: no cell is filled by both robots and similar enough.")
    # Nothing stands in the wave's way, so it arrives after as many steps as the nearest seed is cells away.
    arrival = np.pad(distance_transform_cdt(~seeds, "taxicab"), 1, constant_values=-1)
    offsets = (np.argwhere(SIX_NEIGHBOURS) - 1) @ arrival.strides // arrival.itemsize
    arrival, energy = arrival.ravel(), np.zeros(arrival.size)
    order = np.argsort(arrival, kind="stable")
    start = np.searchsorted(arrival[order], np.arange(1, arrival.max() + 2))
    for layer, (first, last) in enumerate(pairwise(start)):
        cells = order[first:last]
        near = cells[:, None] + offsets
        filled = arrival[near] == layer
        energy[cells] = (energy[near] * filled).sum(1) / filled.sum(1) + step
    return energy.reshape(np.array(seeds.shape) + 2)[1:-1, 1:-1, 1:-1].copy()
