"""From the similarity of two robots to a smooth energy field over the workspace."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, distance_transform_cdt, gaussian_filter

from richmap.similarity.energy_settings import EnergySettings
from richmap.similarity.grid_field import GridField
from richmap.similarity.similarity import SimilarityGrid

SIX_NEIGHBOURS = np.zeros((3, 3, 3), dtype=bool)
SIX_NEIGHBOURS[[0, 2, 1, 1, 1, 1], [1, 1, 0, 2, 1, 1], [1, 1, 1, 1, 0, 2]] = True


@final
@dataclass(frozen=True)
class EnergyField(GridField):
    """Energy of similarity, unitless; low where the robots are alike (RichMap, Eqs. 9-10)."""

    KIND = "richmap.EnergyField"

    @property
    def unit(self) -> str:
        return "1"

    @classmethod
    def from_similarity(
        cls,
        similarity: SimilarityGrid,
        settings: EnergySettings = EnergySettings(),  # noqa: B008, frozen
        about: Mapping[str, str] = MappingProxyType({}),
    ) -> "EnergyField":
        """The field of two robots that were compared: cells where they are alike are seeds, energy rises with the
        distance from them (`propagate`), and the whole is smoothed.

        Args:
            similarity: Of the two robots (`richmap.compare_maps`).
            settings: What shapes the field.
            about: Texts that are kept in its file, such as whose it is.
        """
        energy = propagate(seed_cells(similarity, settings), settings.step)
        smooth = gaussian_filter(energy, settings.smoothing, mode="nearest")
        return cls(similarity.grid, smooth, {**about})


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
