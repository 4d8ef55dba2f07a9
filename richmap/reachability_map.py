"""The reachability map of one robot: approach directions per cell, queries, and its file."""

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int

from richmap.files import FileRefusedError, load_arrays, save_arrays
from richmap.grid import Grid

KIND, VERSION = "richmap.ReachabilityMap", 1


@dataclass(frozen=True)
class Construction:
    """How a map was built: all that its content depends on, and what was reached."""

    robot: str
    robot_fingerprint: str
    theta: float
    """Least angle between two directions of a cell, in [rad]."""
    seed: int
    batch: int
    """Configurations drawn per batch."""
    turns: int
    """Angles of joint 1 per configuration (orbit sampling)."""
    stop_rate: float
    """Building stopped when a smaller fraction of a batch was new."""
    batches: int = 0
    offered: int = 0
    """Poses within the grid that were offered for insertion."""
    batch_rate: float = 1.0
    """Insertion rate of the last batch."""
    independent_rate: float = 1.0
    """Insertion rate among the last batch's independently drawn poses."""


@dataclass(frozen=True)
class ReachabilityMap:
    """Approach directions that one robot's flange reaches in each cell, at least theta apart (RichMap, Eq. 3).

    Directions are sorted by cell: those of flat cell c are rows `start[c]` to `start[c + 1]`.
    """

    grid: Grid
    """In the robot's base frame."""
    start: Int[np.ndarray, " cells1"]
    directions: Float[np.ndarray, "n 3"]
    """Unit vectors in the base frame."""
    joints: Float[np.ndarray, "n dof"]
    """For each direction a configuration that reaches it somewhere in its cell, in [rad]."""
    construction: Construction

    @classmethod
    def from_rows(
        cls,
        grid: Grid,
        cell: Int[np.ndarray, " n"],
        directions: Float[np.ndarray, "n 3"],
        joints: Float[np.ndarray, "n dof"],
        construction: Construction,
    ) -> "ReachabilityMap":
        """Sort directions in order of insertion by cell; within a cell the order is kept."""
        order = np.argsort(cell, kind="stable")
        start = np.zeros(grid.n_cells + 1, dtype=np.int64)
        np.cumsum(np.bincount(cell, minlength=grid.n_cells), out=start[1:])
        return cls(grid, start, directions[order], joints[order], construction)

    @property
    def inserted(self) -> int:
        """Number of stored directions."""
        return len(self.directions)

    @property
    def occupancy(self) -> float:
        """Fraction of cells that hold a direction."""
        return float((np.diff(self.start) > 0).mean())

    def configurations(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n dof"]:
        """Configurations stored with these rows of `directions`, in [rad]."""
        return self.joints[rows].astype(np.float64)

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 over grid, directions and configurations."""
        digest = hashlib.sha256(repr(self.grid).encode())
        for array in (self.start, self.directions, self.joints):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def nearest(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Nearest stored direction in the cell of each pose.

        Args:
            positions: Flange positions in the base frame, in [m].
            directions: Unit approach directions in the base frame.

        Returns:
            Row of `directions` and `joints` (-1 where the cell is empty or outside the grid), and the angle to it in
            [rad] (pi where there is none).
        """
        cell = self.grid.cells_of(positions)
        row, cosine = _nearest(cell, directions.astype(np.float32), self.start, self.directions)
        return row, np.where(row >= 0, np.arccos(np.clip(cosine, -1, 1)), np.pi)

    def reachable(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether a direction closer than theta is stored in the cell of each pose; outside the grid never."""
        return self.nearest(positions, directions)[1] < self.construction.theta

    def save(self, path: Path) -> None:
        """Write the map as one safetensors file, atomically."""
        arrays = {"start": self.start, "directions": self.directions, "joints": self.joints}
        about = {
            "grid": json.dumps(asdict(self.grid)),
            "construction": json.dumps(asdict(self.construction)),
            "content_hash": self.content_hash,
            "frame": f"base frame of {self.construction.robot}; lengths in m, angles in rad",
        }
        save_arrays(path, KIND, VERSION, arrays, about)

    @classmethod
    def load(cls, path: Path) -> "ReachabilityMap":
        """Read a map.

        Raises:
            FileRefusedError: If the file is cut short or damaged, is no map, or has another version.
        """
        arrays, about = load_arrays(path, KIND, VERSION)
        grid, construction = (
            Grid.from_dict(json.loads(about["grid"])),
            Construction(**json.loads(about["construction"])),
        )
        robot_map = cls(grid, construction=construction, **arrays)
        if robot_map.content_hash != about["content_hash"]:
            raise FileRefusedError(
                f"{path} is damaged: its content does not have the hash that it names. Build it anew."
            )
        return robot_map


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _nearest(cells, directions, start, stored):
    rows = np.full(len(cells), -1, dtype=np.int64)
    cosines = np.full(len(cells), -2.0, dtype=np.float32)
    for i in numba.prange(len(cells)):
        if cells[i] >= 0:
            x, y, z = directions[i]
            for row in range(start[cells[i]], start[cells[i] + 1]):
                cosine = x * stored[row, 0] + y * stored[row, 1] + z * stored[row, 2]
                if cosine > cosines[i]:
                    cosines[i] = cosine
                    rows[i] = row
    return rows, cosines
