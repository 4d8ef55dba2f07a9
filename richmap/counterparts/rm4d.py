"""RM4D of one robot, the compact counterpart: which 4-D cells some free sample has hit."""

import json
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float

from richmap.files import check_robot, reading, save_arrays
from richmap.geometry.checked_poses import checked_poses
from richmap.motion.free_samples import free_samples
from richmap.motion.turned_cells import TurnedCells, cell_of
from richmap.robots.robot import RobotDescription

KIND, VERSION = "richmap.RM4D", 1


@dataclass(frozen=True)
class RM4DConstruction:
    """How an RM4D is built; its authors' settings are the defaults."""

    robot: str
    robot_fingerprint: str
    seed: int
    cell_size: float = 0.05
    """Edge of a cell along x*, y* and z, in [m]."""
    angles: int = 36
    """Cells along beta, of 5 degrees each."""
    samples: int = 10_000_000


@dataclass(frozen=True)
class RM4D:
    """Cells of (x*, y*, z, beta) that a configuration free of self-collision reaches (Rudorfer, RM4D, 2025)."""

    cells: TurnedCells
    """In the robot's base frame."""
    hit: Bool[np.ndarray, "nx ny nz angles"]
    construction: RM4DConstruction

    @property
    def inserted(self) -> int:
        """Number of cells that are marked."""
        return int(self.hit.sum())

    @property
    def bytes_memory(self) -> int:
        """Bytes of all arrays."""
        return self.hit.nbytes

    def reachable(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether the cell of each pose is marked; outside the cells never.

        Args:
            positions: Flange positions in the base frame, in [m].
            directions: Unit approach directions in the base frame.

        Raises:
            ValueError: If the shapes are not (n, 3), or a direction is no unit vector.
        """
        positions, directions = checked_poses(positions, directions)
        reachable = np.empty(len(positions), dtype=bool)
        _look_up(positions, directions, *self.cells.for_kernels(), self.hit.reshape(-1), reachable)
        return reachable

    def save(self, path: Path) -> None:
        """Write the map as one safetensors file, atomically."""
        about = {
            "cells": json.dumps(asdict(self.cells)),
            "construction": json.dumps(asdict(self.construction)),
            "frame": f"base frame of {self.construction.robot}; lengths in m, angles in rad",
        }
        save_arrays(path, KIND, VERSION, {"hit": self.hit}, about)

    @classmethod
    def load(cls, path: Path | str, robot: RobotDescription | None = None) -> "RM4D":
        """Read a map.

        Args:
            path: The file.
            robot: The arm that it must be of, if that matters.

        Raises:
            FileRefusedError: If the file is cut short, is no such map, or has another version or another robot.
        """
        with reading(path, KIND, VERSION) as (arrays, about):
            construction = RM4DConstruction(**json.loads(about["construction"]))
            check_robot(path, construction.robot, construction.robot_fingerprint, robot)
            return cls(TurnedCells.from_dict(json.loads(about["cells"])), arrays["hit"], construction)


def build_rm4d(
    robot: RobotDescription,
    construction: RM4DConstruction,
    pool: Executor,
    report: Callable[[int], None] = lambda done: None,
) -> RM4D:
    """Build a robot's RM4D.

    Samples are an even sequence instead of random ones, and are only checked for self-collision where nothing is marked
    yet; otherwise as its authors do it.

    Args:
        robot: The arm.
        construction: Settings.
        pool: Where collision checks run, such as processes (`richmap.worker.start_worker`).
        report: Called with the number of samples drawn, now and then.

    Raises:
        NoTurnError: If joint 1 does not turn the arm about the base frame's z axis.
    """
    cells = TurnedCells.around(robot, construction.cell_size, construction.angles)
    marked, _ = free_samples(robot, cells, construction.samples, construction.seed, pool, report)
    hit = np.zeros(cells.n_cells, dtype=bool)
    hit[marked] = True
    return RM4D(cells, hit.reshape(cells.shape), construction)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _look_up(positions, directions, radius, bottom, per_metre, shape, hit, reachable):
    for i in range(len(positions)):
        cell = cell_of(positions[i], directions[i], radius, bottom, per_metre, shape)
        reachable[i] = cell >= 0 and hit[cell]
