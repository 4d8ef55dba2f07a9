"""The regular grid of cells that a map, a similarity and an energy field live on."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Cells(NamedTuple):
    """A grid as compiled loops read it."""

    origin: Float[np.ndarray, "3"]
    cell_size: float
    shape: Int[np.ndarray, "3"]


class GridMismatchError(ValueError):
    """Two maps cannot be compared because their cells do not coincide."""


@dataclass(frozen=True)
class Grid:
    """Cubic cells fixed to a frame; cell (i, j, k) spans `origin + cell_size * [i, i+1)` and so on."""

    origin: tuple[float, float, float]
    """Lower corner of cell (0, 0, 0), in [m]."""
    cell_size: float
    """Edge of a cell (the paper's Delta), in [m]."""
    shape: tuple[int, int, int]
    """Number of cells along x, y, z."""

    @classmethod
    def around_base(cls, cell_size: float, half_width: float, z_offset: float) -> "Grid":
        """The paper's workspace: [-w, w] x [-w, w] x [-w + z_offset, w + z_offset] about the base, in [m]."""
        cells = int(np.ceil(2 * half_width / cell_size - 1e-9))
        origin = (-half_width, -half_width, -half_width + z_offset)
        return cls(origin, cell_size, (cells, cells, cells))

    @classmethod
    def from_dict(cls, fields: dict) -> "Grid":
        """The inverse of `dataclasses.asdict` after a passage through JSON."""
        return cls(tuple(fields["origin"]), fields["cell_size"], tuple(fields["shape"]))

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    @property
    def cells(self) -> Cells:
        """What compiled loops read of the grid."""
        return Cells(np.array(self.origin), self.cell_size, np.array(self.shape))

    def cells_of(self, points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Flat index of the cell that holds each point, in [m]; -1 outside the grid (RichMap, Eq. 1, unclamped)."""
        index = np.floor((points - np.array(self.origin)) / self.cell_size).astype(np.int64)
        inside = ((index >= 0) & (index < self.shape)).all(1)
        flat = np.ravel_multi_index(tuple(np.where(inside[:, None], index, 0).T), self.shape)
        return np.where(inside, flat, -1)

    def centres(self) -> Float[np.ndarray, "n 3"]:
        """Centres of all cells in flat order, in [m]."""
        return np.stack(np.meshgrid(*self.axes(), indexing="ij"), -1).reshape(-1, 3)

    def axes(self) -> list[Float[np.ndarray, " _"]]:
        """Coordinates of the cells' centres along x, y and z, in [m]."""
        return [o + self.cell_size * (np.arange(n) + 0.5) for o, n in zip(self.origin, self.shape, strict=True)]

    def moved(self, offset: Float[np.ndarray, " 3"]) -> "Grid":
        """The same cells seen from a frame at `offset`, in [m]: cells of two robots then coincide in the world."""
        x, y, z = (float(o - d) for o, d in zip(self.origin, offset, strict=True))
        return Grid((x, y, z), self.cell_size, self.shape)
