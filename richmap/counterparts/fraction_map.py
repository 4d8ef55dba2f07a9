"""The small, precise map of one robot: how much of each 4-D cell is reachable, interpolated between cells."""

import json
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import generate_binary_structure, maximum_filter, minimum_filter

from richmap.files import check_robot, reading, save_arrays
from richmap.geometry.checked_poses import checked_poses
from richmap.motion.collision import self_collision
from richmap.motion.free_samples import free_samples, in_chunks
from richmap.motion.inverse_kinematics import ANGLE_TOLERANCE, POSITION_TOLERANCE, refine
from richmap.motion.kinematics import flange_frames
from richmap.motion.turned_cells import TurnedCells, turned
from richmap.robots.robot import RobotDescription

KIND, VERSION = "richmap.FractionMap", 1

SUB_CELLS = [np.array(within) for within in product((0.25, 0.75), repeat=4)]
"""Centres of a cell's sub-cells, as fractions of its edges; how many of them are reachable is stored."""

FULL = len(SUB_CELLS)

ROUNDS = 3
"""Times that configurations are handed on from cells that have one to their neighbours that do not."""

ITERATIONS = 12
"""Steps of inverse kinematics from a configuration in a cell to a point in it or in the next."""


@dataclass(frozen=True)
class FractionConstruction:
    """How a fraction map is built: all that its content depends on."""

    robot: str
    robot_fingerprint: str
    cell_size: float
    """Edge of a cell along x*, y* and z, in [m]."""
    angles: int
    """Cells along beta."""
    samples: int
    """Configurations drawn to begin with."""
    seed: int


@dataclass(frozen=True)
class FractionMap:
    """Share of each 4-D cell that one robot's flange reaches with a roll of its choice.

    A score is interpolated linearly between the cells' centres, and a pose counts as reachable from a threshold on. It
    is 1/2 where the boundary runs, and can be chosen anew on labelled poses (`with_threshold_from`).
    """

    cells: TurnedCells
    """In the robot's base frame."""
    row: Int[np.ndarray, "nx ny nz"]
    """Row of `hits` for each place; -1 where nothing is reachable."""
    hits: UInt8[np.ndarray, "rows angles"]
    """Reachable sub-cell centres per cell, 0 to 16."""
    construction: FractionConstruction
    threshold: float = 0.5

    @property
    def inserted(self) -> int:
        """Number of cells of which something is reachable."""
        return int((self.hits > 0).sum())

    @property
    def bytes_memory(self) -> int:
        """Bytes of all arrays."""
        return self.row.nbytes + self.hits.nbytes

    def score(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """Interpolated share that is reachable about each pose, 0 to 1; 0 outside.

        Args:
            positions: Flange positions in the base frame, in [m].
            directions: Unit approach directions in the base frame.

        Raises:
            ValueError: If the shapes are not (n, 3), or a direction is no unit vector.
        """
        positions, directions = checked_poses(positions, directions)
        scores = np.empty(len(positions), dtype=np.float32)
        _interpolate(positions, directions, *self.cells.for_kernels(), self.row, self.hits, scores)
        return scores

    def reachable(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether the score of each pose is the threshold or more; arguments as for `score`."""
        return self.score(positions, directions) >= self.threshold

    def with_threshold_from(
        self,
        positions: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        reachable: Bool[np.ndarray, " n"],
        negatives: float = 1.0,
    ) -> "FractionMap":
        """The same map with the threshold that is wrong least often on these poses.

        Args:
            positions: Flange positions in the base frame, in [m].
            directions: Unit approach directions in the base frame.
            reachable: Their labels.
            negatives: Weight of an unreachable pose that is taken for reachable, against one the other way round.
        """
        score = self.score(positions, directions)
        order = np.argsort(score)
        missed = np.concatenate([[0], np.cumsum(reachable[order])])  # below the threshold, though reachable
        passed = (~reachable).sum() - np.concatenate([[0], np.cumsum(~reachable[order])])
        edges = np.concatenate([[0], score[order], [1]])
        cut = int(np.argmin(missed + negatives * passed))
        return replace(self, threshold=max(float((edges[cut] + edges[cut + 1]) / 2), 1e-6))

    def save(self, path: Path) -> None:
        """Write the map as one safetensors file, atomically."""
        about = {
            "cells": json.dumps(asdict(self.cells)),
            "construction": json.dumps(asdict(self.construction)),
            "threshold": repr(self.threshold),
            "frame": f"base frame of {self.construction.robot}; lengths in m, angles in rad",
        }
        save_arrays(path, KIND, VERSION, {"row": self.row, "hits": self.hits}, about)

    @classmethod
    def load(cls, path: Path | str, robot: RobotDescription | None = None) -> "FractionMap":
        """Read a map.

        Args:
            path: The file.
            robot: The arm that it must be of, if that matters.

        Raises:
            FileRefusedError: If the file is cut short, is no such map, or has another version or another robot.
        """
        with reading(path, KIND, VERSION) as (arrays, about):
            construction = FractionConstruction(**json.loads(about["construction"]))
            check_robot(path, construction.robot, construction.robot_fingerprint, robot)
            cells = TurnedCells.from_dict(json.loads(about["cells"]))
            return cls(cells, **arrays, construction=construction, threshold=float(about["threshold"]))


@dataclass(frozen=True)
class FractionProgress:
    """Where a build stands."""

    stage: str
    """Sampling, centres or boundary."""
    done: int
    total: int
    """Samples, or cells, of this stage."""


def build_fraction_map(
    robot: RobotDescription,
    construction: FractionConstruction,
    pool: Executor,
    report: Callable[[FractionProgress], None] = lambda progress: None,
) -> FractionMap:
    """Build a robot's fraction map.

    Any-hit marking makes a map too large by about half a cell everywhere. Here points are decided instead, each by a
    few steps of inverse kinematics from a configuration nearby: first every cell's centre, then, of cells whose
    neighbourhood is neither all reachable nor all unreachable, the centres of the sub-cells. The result does not depend
    on the number of workers.

    Args:
        robot: The arm.
        construction: Settings.
        pool: Where inverse kinematics and collision checks run, such as processes (`richmap.worker.start_worker`).
        report: Called as the work goes on.

    Raises:
        NoTurnError: If joint 1 does not turn the arm about the base frame's z axis.
    """
    cells = TurnedCells.around(robot, construction.cell_size, construction.angles)
    points = _Points(robot, cells, pool)
    total = construction.samples
    points.add(
        *free_samples(
            robot, cells, total, construction.seed, pool,
            lambda done: report(FractionProgress("sampling", done, total)),
        )
    )  # fmt: skip
    centres = points.centres(lambda done, total: report(FractionProgress("centres", done, total)))
    boundary = _boundary(centres.reshape(cells.shape))
    hits = np.where(centres, FULL, 0).astype(np.uint8)
    hits[boundary] = 0
    for k, within in enumerate(SUB_CELLS):
        report(FractionProgress("boundary", k * len(boundary), FULL * len(boundary)))
        hits[boundary] += points.reached(boundary, within)
    report(FractionProgress("boundary", FULL * len(boundary), FULL * len(boundary)))
    hits = hits.reshape(cells.shape)
    filled = hits.any(axis=3)
    row = np.full(filled.shape, -1, dtype=np.int32)
    row[filled] = np.arange(filled.sum())
    return FractionMap(cells, row, hits[filled], construction)


class _Points:
    """Decides which points of cells are reachable, from the configurations that are known so far."""

    def __init__(self, robot: RobotDescription, cells: TurnedCells, pool: Executor) -> None:
        self._robot, self._cells, self._pool = robot, cells, pool
        self._known = np.zeros(cells.n_cells, dtype=bool)
        self._joints = np.empty((cells.n_cells, len(robot.joints)), dtype=np.float32)

    def add(self, cells: Int[np.ndarray, " n"], joints: Float[np.ndarray, "n dof"]) -> None:
        """A configuration in each of these cells."""
        self._known[cells], self._joints[cells] = True, joints

    def centres(self, report: Callable[[int, int], None]) -> Bool[np.ndarray, " cells"]:
        """Which cells' centres are reachable, and a configuration for every cell that gets one on the way."""
        reached = np.zeros(self._cells.n_cells, dtype=bool)
        cells = np.flatnonzero(self._known)
        for k in range(ROUNDS + 1):
            report(k, ROUNDS + 1)
            reached[cells] = self.reached(cells, np.full(4, 0.5))
            around = [self._cells.neighbours(np.flatnonzero(self._known), *next_to) for next_to in _SIDES]
            cells = np.unique(np.concatenate(around))
            cells = cells[(cells >= 0)]
            cells = cells[~self._known[cells]]
        report(ROUNDS + 1, ROUNDS + 1)
        return reached

    def reached(self, cells: Int[np.ndarray, " n"], within: Float[np.ndarray, " 4"]) -> Bool[np.ndarray, " n"]:
        """Whether a point of each cell is reachable, from the cell's configuration or its neighbours'.

        Args:
            cells: Flat indices.
            within: Where in the cells, from 0 to 1 along each coordinate; only the neighbours on that side are asked.
        """
        reached = np.zeros(len(cells), dtype=bool)
        sides = [(axis, way) for axis, way in _SIDES if way * (within[axis] - 0.5) >= 0]
        for from_cells in (cells, *(self._cells.neighbours(cells, *side) for side in sides)):
            todo = np.flatnonzero(~reached & (from_cells >= 0) & self._known[from_cells])
            points = self._cells.points(cells[todo], within)
            hit, joints = in_chunks(self._pool, _reach, self._robot, points, self._joints[from_cells[todo]])
            reached[todo] = hit
            gained = todo[hit]
            new = ~self._known[cells[gained]]
            self.add(cells[gained[new]], joints[hit][new])
        return reached


_SIDES = [(axis, way) for axis in range(4) for way in (1, -1)]


def _boundary(centres: Bool[np.ndarray, "nx ny nz angles"]) -> Int[np.ndarray, " n"]:
    """Flat indices of the cells that do not have the same answer as the next cells along each coordinate."""
    cross = generate_binary_structure(4, 1)  # The whole neighbourhood takes twice as long and changes no figure.
    greatest = maximum_filter(centres, footprint=cross, mode="nearest")
    return np.flatnonzero(greatest != minimum_filter(centres, footprint=cross, mode="nearest"))


def _reach(
    robot: RobotDescription, points: Float[np.ndarray, "n 4"], joints: Float[np.ndarray, "n dof"]
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "n dof"]]:
    """Whether each point is reached, from a configuration nearby, within joint limits and without self-collision.

    Returns:
        The answers, and configurations where they are yes, in [rad].
    """
    joints = joints.astype(np.float64)
    joints[:, 0] = (robot.lower[0] + robot.upper[0]) / 2  # The point turns with joint 1, so its limits do not bind.
    _, rotation = flange_frames(robot, joints)
    azimuth = np.arctan2(rotation[:, 1, 2], rotation[:, 0, 2])
    position, orientation = _poses(points, azimuth)
    joints, off, angle = refine(robot, joints, position, orientation, ITERATIONS, free_roll=True)
    reached = (off <= POSITION_TOLERANCE) & (angle <= ANGLE_TOLERANCE)
    reached[reached] = ~self_collision(robot)(joints[reached])
    return reached, joints


def _poses(
    points: Float[np.ndarray, "n 4"], azimuth: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Flange poses of points (x*, y*, z, beta) whose approach directions have these azimuths, in [rad]."""
    x, y, z, beta = points.T
    c, s, cb, sb, zero = np.cos(azimuth), np.sin(azimuth), np.cos(beta), np.sin(beta), np.zeros(len(points))
    position = np.stack([c * x - s * y, s * x + c * y, z], axis=1)
    return position, np.stack([c * cb, -s, c * sb, s * cb, c, s * sb, -sb, zero, cb], axis=1).reshape(-1, 3, 3)


@numba.njit(cache=True, nogil=True, fastmath=True)
@no_type_check
def _interpolate(positions, directions, radius, bottom, per_metre, shape, row, hits, scores):
    for i in range(len(positions)):
        x, y, z, beta = turned(positions[i], directions[i], radius, bottom, per_metre, shape)
        scores[i] = 0
        if not (0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= z < shape[2]):
            continue
        x, y, z, beta = x - 0.5, y - 0.5, z - 0.5, min(max(beta - 0.5, 0.0), shape[3] - 1.0)
        i0, j0, k0, b = int(x + 1) - 1, int(y + 1) - 1, int(z + 1) - 1, min(int(beta), shape[3] - 2)
        above = beta - b
        total = 0.0
        for corner in range(8):
            di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
            ci, cj, ck = i0 + di, j0 + dj, k0 + dk
            if 0 <= ci < shape[0] and 0 <= cj < shape[1] and 0 <= ck < shape[2] and row[ci, cj, ck] >= 0:
                cell = hits[row[ci, cj, ck]]
                u, v, w = abs(1 - di - (x - i0)), abs(1 - dj - (y - j0)), abs(1 - dk - (z - k0))
                total += u * v * w * ((1 - above) * cell[b] + above * cell[b + 1])
        scores[i] = total / FULL
