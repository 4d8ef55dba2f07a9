"""From where an arm can hold its tool over a table to the signed distance to the border of that."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt, gaussian_filter

from richmap.geometry.grid import Grid
from richmap.similarity.grid_field import GridField

SMOOTHING = 1.0
"""Standard deviation of the Gaussian filter over the distance, in [cells]; it rounds the corners of cells."""
LEVELS = 4
"""Cells above each other: the least that a cubic spline goes through. The distance is the same in all."""
NOWHERE = 1.0
"""Distance to the border where there is none, in [m]."""


@final
@dataclass(frozen=True)
class SignedDistanceField(GridField):
    """Signed distance to the border of what an arm can hold, in [m]: above 0 where it cannot."""

    inner: float
    """Inner radius of the widest ring about the base that the arm can hold, in [m]; 0 where the table ends before, or
    there is no ring."""
    outer: float
    """Its outer radius, in [m]; infinity likewise."""

    KIND = "richmap.SignedDistanceField"

    @property
    def unit(self) -> str:
        return "m"

    @classmethod
    def from_feasible(
        cls,
        feasible: Bool[np.ndarray, "nx ny"],
        origin: tuple[float, float],
        cell_size: float,
        height: float,
        base: tuple[float, float],
        about: dict[str, str],
    ) -> "SignedDistanceField":
        """The field of an arm, the same at all heights.

        Args:
            feasible: Whether the arm can hold its tool upright over the centre of each cell of the table.
            origin: Lower corner of cell (0, 0), world frame, in [m].
            cell_size: Edge of a cell, in [m].
            height: Of the flange above the table, in [m]; the middle of the field.
            base: Position of the arm's base, x and y in [m].
            about: Provenance.

        Raises:
            ValueError: If the arm can hold its tool nowhere.
        """
        if not feasible.any():
            raise ValueError("The arm can hold its tool upright nowhere over the table. Choose another base or wrist.")
        if feasible.all():
            distance = np.full(feasible.shape, -NOWHERE)
        else:  # The border runs between two cells, half a cell from either's centre.
            outside = distance_transform_edt(~feasible) - 0.5
            inside = 0.5 - distance_transform_edt(feasible)
            distance = gaussian_filter(np.where(feasible, inside, outside) * cell_size, SMOOTHING, mode="nearest")
        grid = Grid((*origin, height - LEVELS / 2 * cell_size), cell_size, (*feasible.shape, LEVELS))
        x, y = grid.axes()[:2]
        radius = np.hypot(x[:, None] - base[0], y[None] - base[1])
        inner, outer = feasible_ring(feasible, radius, cell_size)
        return cls(grid, np.repeat(distance[:, :, None], LEVELS, axis=2), about, inner, outer)


def feasible_ring(
    feasible: Bool[np.ndarray, "nx ny"], radius: Float[np.ndarray, "nx ny"], width: float
) -> tuple[float, float]:
    """The widest ring about the base in which the arm can hold its tool nearly everywhere (90 % of the cells).

    Args:
        feasible: Whether the arm can hold its tool over each cell.
        radius: Distance of the cells' centres from the base axis, in [m].
        width: Of the rings that are looked at one by one, in [m].

    Returns:
        Inner and outer radius, in [m]; 0 and infinity where the table ends before the ring does, and where there is no
        such ring, as with a first joint that hardly turns.
    """
    number = np.floor(radius / width).astype(int).ravel()
    cells = np.bincount(number)
    share = np.bincount(number, weights=feasible.ravel()) / np.maximum(cells, 1)
    whole = np.flatnonzero(cells)[share[cells > 0] >= 0.9]  # numbers of the rings that are feasible
    if len(whole) == 0:
        return 0.0, np.inf
    runs = np.split(whole, np.flatnonzero(np.diff(whole) > 1) + 1)
    longest = max(runs, key=len)
    first, last = np.flatnonzero(cells)[[0, -1]]
    inner = 0.0 if longest[0] == first else longest[0] * width
    outer = np.inf if longest[-1] == last else (longest[-1] + 1) * width
    return float(f"{inner:g}"), float(f"{outer:g}")  # Six digits, so that 35 cells of 0.02 m are 0.7 m.
