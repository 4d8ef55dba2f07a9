"""The capability map of one robot: full orientations per cell, queries for 6-D poses, and its file."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from richmap.files import check_robot, reading, save_arrays
from richmap.geometry.checked_poses import checked_poses
from richmap.geometry.grid import Grid
from richmap.geometry.rotations import quaternions_of
from richmap.robots.robot import RobotDescription

KIND, VERSION = "richmap.CapabilityMap", 1

CHUNK = 64
"""Stored quaternions that a query compares before it looks whether one was near: loops without an exit use SIMD."""

JOINT_STEPS = 65535
"""Steps in which a joint's range is stored."""


@dataclass(frozen=True)
class CapabilityConstruction:
    """How a capability map was built: all that its content depends on, and what was reached."""

    robot: str
    robot_fingerprint: str
    theta: float
    """Least angle between two orientations of a cell, in [rad]."""
    seed: int
    draw: int
    """Configurations drawn at once."""
    turns: int
    """Angles of joint 1 per configuration (orbit sampling)."""
    stop_rate: float
    """Building stopped when a smaller fraction of a draw's poses was new."""
    target: int
    """Building stopped when this many orientations were stored; 0 for no such target."""
    draws: int = 0
    offered: int = 0
    """Poses within the grid that were offered for insertion."""
    batch_rate: float = 1.0
    """Insertion rate of the last draw."""


@dataclass(frozen=True)
class CapabilityMap:
    """Orientations that one robot's flange takes in each cell, at least theta apart as rotations.

    The full-quaternion variant of the reachability map (RichMap, "Full quaternion representation"). With theta = 0.4
    rad it is the paper's counterpart, the Capability Map (Zacharias et al., 2013) in the same framework.
    Orientations are sorted by cell: those of flat cell c are rows `start[c]` to `start[c + 1]`.
    """

    grid: Grid
    """In the robot's base frame."""
    start: Int[np.ndarray, " cells1"]
    quaternions: Float[np.ndarray, "n 4"]
    """Unit quaternions (w, x, y, z) of the flange in the base frame, w >= 0; each component lies in one piece."""
    joints: UInt[np.ndarray, "n dof"]
    """For each orientation a configuration that takes it somewhere in its cell; see `configurations`."""
    limits: Float[np.ndarray, "2 dof"]
    """Lower and upper joint limits, in [rad]: `joints` counts from the one to the other."""
    construction: CapabilityConstruction

    @classmethod
    def from_rows(
        cls,
        grid: Grid,
        cell: Int[np.ndarray, " n"],
        quaternions: Float[np.ndarray, "n 4"],
        joints: UInt[np.ndarray, "n dof"],
        limits: Float[np.ndarray, "2 dof"],
        construction: CapabilityConstruction,
    ) -> "CapabilityMap":
        """Sort orientations in order of insertion by cell; within a cell the order is kept."""
        order = np.argsort(cell, kind="stable")
        start = np.zeros(grid.n_cells + 1, dtype=np.int64)
        np.cumsum(np.bincount(cell, minlength=grid.n_cells), out=start[1:])
        return cls(grid, start, quaternions.T[:, order].T, joints[order], limits, construction)

    @property
    def inserted(self) -> int:
        """Number of stored orientations."""
        return len(self.quaternions)

    @property
    def occupancy(self) -> float:
        """Fraction of cells that hold an orientation."""
        return float((np.diff(self.start) > 0).mean())

    @property
    def avg_per_cell(self) -> float:
        """Mean number of orientations in the cells that hold any."""
        return self.inserted / max((np.diff(self.start) > 0).sum(), 1)

    @property
    def insertion_rate(self) -> float:
        """Fraction of all offered poses that were stored (the paper's whole IR)."""
        return self.inserted / max(self.construction.offered, 1)

    @property
    def bytes_memory(self) -> int:
        """Bytes of all arrays."""
        return self.start.nbytes + self.quaternions.nbytes + self.joints.nbytes + self.limits.nbytes

    def configurations(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n dof"]:
        """Configurations stored with these rows of `quaternions`, in [rad]."""
        lower, upper = self.limits
        return lower + (upper - lower) / JOINT_STEPS * self.joints[rows]

    def reachable(
        self, positions: Float[np.ndarray, "n 3"], rotations: Float[np.ndarray, "n 3 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether an orientation closer than theta is stored in the cell of each pose; outside the grid never.

        Args:
            positions: Flange positions in the base frame, in [m].
            rotations: Flange orientations in the base frame; columns are the flange's axes.
        """
        positions, _ = checked_poses(positions, rotations[..., 2])
        squared = np.float32(np.cos(self.construction.theta / 2) ** 2)
        cells = self.grid.cells_of(positions)
        return _any_near(cells, quaternions_of(rotations), self.start, self.quaternions.T, squared)

    def save(self, path: Path) -> None:
        """Write the map as one safetensors file, atomically."""
        arrays = {"start": self.start, "quaternions": self.quaternions.T, "joints": self.joints, "limits": self.limits}
        about = {
            "grid": json.dumps(asdict(self.grid)),
            "construction": json.dumps(asdict(self.construction)),
            "frame": f"base frame of {self.construction.robot}; lengths in m, angles in rad; quaternions (w, x, y, z)",
        }
        save_arrays(path, KIND, VERSION, arrays, about)

    @classmethod
    def load(cls, path: Path | str, robot: RobotDescription | None = None) -> "CapabilityMap":
        """Read a map.

        Args:
            path: The file.
            robot: The arm that it must be of, if that matters.

        Raises:
            FileRefusedError: If the file is cut short or damaged, is no map, or has another version or another robot.
        """
        with reading(path, KIND, VERSION) as (arrays, about):
            construction = CapabilityConstruction(**json.loads(about["construction"]))
            check_robot(path, construction.robot, construction.robot_fingerprint, robot)
            return cls(
                Grid.from_dict(json.loads(about["grid"])),
                arrays["start"],
                arrays["quaternions"].T,
                arrays["joints"],
                arrays["limits"],
                construction,
            )


@numba.njit(cache=True, inline="always", fastmath=True)
@no_type_check
def _hits(stored, first, last, q, squared):
    """How many of these columns have a squared scalar product above a value with a quaternion."""
    hits = np.int32(0)
    w, x, y, z = q
    for k in range(first, last):
        product = stored[0, k] * w + stored[1, k] * x + stored[2, k] * y + stored[3, k] * z
        hits += np.int32(product * product > squared)
    return hits


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _any_near(cells, quaternions, start, stored, squared):
    found = np.zeros(len(cells), dtype=np.bool_)
    for i in numba.prange(len(cells)):
        if cells[i] >= 0:
            last = start[cells[i] + 1]
            for first in range(start[cells[i]], last, CHUNK):
                if _hits(stored, first, min(first + CHUNK, last), quaternions[i], squared) > 0:
                    found[i] = True
                    break
    return found
