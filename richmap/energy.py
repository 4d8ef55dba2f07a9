"""From the similarity of two robots to a smooth energy field over the workspace."""

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.ndimage import convolve, gaussian_filter

from richmap.files import load_arrays, save_arrays
from richmap.grid import Grid
from richmap.similarity import SimilarityGrid

KIND, VERSION = "richmap.EnergyField", 1

SIX_NEIGHBOURS = np.zeros((3, 3, 3))
SIX_NEIGHBOURS[[0, 2, 1, 1, 1, 1], [1, 1, 0, 2, 1, 1], [1, 1, 1, 1, 0, 2]] = 1


@dataclass(frozen=True)
class EnergySettings:
    """What shapes the field; the paper leaves most of it open."""

    step: float = 0.01
    """Energy added per cell of distance from the seeds (the paper's delta), unitless."""
    smoothing: float = 1.0
    """Standard deviation of the Gaussian filter, in [cells]."""
    central_radius: float = 0.1
    """Cells whose centre is nearer to the base axis are not seeds, in [m]."""
    empty: str = "unfilled"
    """What cells are that not both robots fill: "unfilled", or "seed" as the paper's formula literally reads."""


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
        lower, upper = (np.array([axis[end] for axis in self.grid.axes()]) for end in (0, -1))
        outside = ~((points >= lower) & (points <= upper)).all(1)
        if outside.any():
            raise ValueError(f"{points[outside][0]} m is outside the energy field, from {lower} to {upper} m.")
        gradient = [self._spline(points, nu=nu) for nu in np.eye(3, dtype=int)]
        return self._spline(points), np.stack(gradient, axis=1)

    @cached_property
    def _spline(self) -> NdBSpline:
        knots, coefficients = [], self.values
        for axis, centres in enumerate(self.grid.axes()):
            spline = make_interp_spline(centres, coefficients, k=3, axis=axis)
            knots.append(spline.t)
            coefficients = np.moveaxis(spline.c, 0, axis)
        return NdBSpline(tuple(knots), coefficients, k=3)

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

    The threshold is the mean of the positive discrepancies over cells that both robots fill.
    """
    mmd = similarity.mmd
    threshold = mmd[mmd > 0].mean() if (mmd > 0).any() else 0.0
    seeds = np.nan_to_num(mmd, nan=np.inf) <= threshold
    if settings.empty == "seed":
        seeds |= np.isnan(mmd)
    elif settings.empty != "unfilled":
        raise ValueError(f'empty={settings.empty!r} is neither "unfilled" nor "seed".')
    centres = similarity.grid.centres()
    seeds &= np.hypot(centres[:, 0], centres[:, 1]) >= settings.central_radius
    seeds = seeds.reshape(similarity.grid.shape)
    return seeds & (_neighbours(seeds) > 0)


def propagate(seeds: Bool[np.ndarray, "nx ny nz"], step: float) -> Float[np.ndarray, "nx ny nz"]:
    """Fill the grid layer by layer: the mean of the filled 6-neighbours plus `step` (RichMap, Eq. 10).

    Raises:
        ValueError: If there is no seed.
    """
    if not seeds.any():
        raise ValueError("The energy field has no seed: no cell is filled by both robots and similar enough.")
    energy, filled = np.zeros(seeds.shape), seeds.copy()
    while not filled.all():
        count = _neighbours(filled)
        layer = ~filled & (count > 0)
        energy[layer] = _neighbours(energy * filled)[layer] / count[layer] + step
        filled |= layer
    return energy


def _neighbours(values: np.ndarray) -> Float[np.ndarray, "nx ny nz"]:
    """Sum over the 6-neighbours within the grid."""
    return convolve(values.astype(float), SIX_NEIGHBOURS, mode="constant")
