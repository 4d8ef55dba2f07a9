"""Building a capability map: worker processes sample the workspace, this process inserts their batches in order."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from richmap.counterparts.capability_map import JOINT_STEPS, CapabilityConstruction, CapabilityMap
from richmap.geometry.grid import Grid
from richmap.geometry.rotations import quaternions_of
from richmap.motion.kinematics import flange_frames
from richmap.motion.sampling import sample_workspace
from richmap.outputs import FileRefusedError
from richmap.robots.robot import RobotDescription
from richmap.worker import worker_pool

PAGE = 64
"""Quaternions of a cell that lie together: enough for SIMD, few enough to waste none."""

SAVE_INTERVAL = 60.0
"""Seconds between two copies of the unfinished map on disk."""


@dataclass(frozen=True)
class OrientationSamples:
    """Flange poses with the configurations that take them, within joint limits and free of self-collision."""

    position: Float[np.ndarray, "n 3"]
    """Origin of the flange in the base frame, in [m]."""
    quaternion: Float[np.ndarray, "n 4"]
    """Orientation (w, x, y, z) of the flange in the base frame."""
    joints: UInt[np.ndarray, "n dof"]
    """Configurations as `CapabilityMap.joints` stores them."""


@dataclass(frozen=True)
class CapabilityProgress:
    """Where a build stands after a draw."""

    draws: int
    inserted: int
    occupancy: float
    """Fraction of cells that hold an orientation."""
    batch_rate: float
    """Insertion rate of the draw."""


class _Pages(NamedTuple):
    """What is stored, in pages of `PAGE` quaternions; a cell's pages follow each other."""

    counts: Int[np.ndarray, " cells"]
    """Quaternions in each cell."""
    first: Int[np.ndarray, " cells"]
    """Each cell's first page, -1 for none."""
    last: Int[np.ndarray, " cells"]
    page: Float[np.ndarray, "pages 4 lanes"]
    following: Int[np.ndarray, " pages"]
    """The page after each, -1 for none."""


class QuaternionInserter:
    """A capability map under construction: batches in, theta-separated orientations out.

    Each cell has a chain of pages of quaternions, which a new one is compared with page after page until one is too
    near. Poses are taken cell after cell, so that its pages stay in the processor's cache; within a cell they keep
    their order, and cells do not know of each other, so the result is that of inserting pose after pose.
    """

    def __init__(self, grid: Grid, theta: float) -> None:
        self.grid = grid
        self.offered = 0
        self._squared = np.float32(np.cos(theta / 2) ** 2)
        counts = np.zeros(grid.n_cells, dtype=np.int32)
        first, last = np.full((2, grid.n_cells), -1, dtype=np.int32)
        self._pages = _Pages(
            counts, first, last, np.zeros((1024, 4, PAGE), dtype=np.float32), np.zeros(1024, dtype=np.int32)
        )
        self._used = 0
        self._rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    @property
    def inserted(self) -> int:
        """Number of stored orientations."""
        return int(self._pages.counts.sum())

    @property
    def occupancy(self) -> float:
        """Fraction of cells that hold an orientation."""
        return float((self._pages.counts > 0).mean())

    def insert(self, samples: OrientationSamples) -> Bool[np.ndarray, " n"]:
        """Insert a batch; tells which of its poses were stored. Poses outside the grid never are."""
        cell = self.grid.cells_of(samples.position)
        self.offered += int((cell >= 0).sum())
        return self._insert(cell, samples.quaternion, samples.joints, self._squared)

    def resume(self, unfinished: CapabilityMap) -> None:
        """Take over all that an unfinished map has stored."""
        cell = np.repeat(np.arange(self.grid.n_cells), np.diff(unfinished.start))
        self.offered = unfinished.construction.offered
        self._insert(cell, np.ascontiguousarray(unfinished.quaternions), unfinished.joints, np.float32(2))

    def stored(self) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 4"], UInt[np.ndarray, "n dof"]]:
        """Cell, quaternion and configuration of all that is stored, in order of insertion within each cell."""
        cell, quaternion, joints = (np.concatenate(column) for column in zip(*self._rows, strict=True))
        return cell, quaternion, joints

    def _insert(
        self, cell: np.ndarray, quaternion: np.ndarray, joints: np.ndarray, squared: np.float32
    ) -> Bool[np.ndarray, " n"]:
        order = np.argsort(cell, kind="stable")
        order = order[np.searchsorted(cell[order], 0) :]
        self._reserve(self._used + len(order) // PAGE + min(len(order), self.grid.n_cells))
        stored = np.zeros(len(cell), dtype=bool)
        self._used = _insert_in_order(order, cell, quaternion, squared, stored, self._pages, self._used)
        self._rows.append((cell[stored].astype(np.int32), quaternion[stored], joints[stored]))
        return stored

    def _reserve(self, pages: int) -> None:
        if pages > len(self._pages.page):  # Pages that are not used yet take no memory.
            page, following = np.zeros((2 * pages, 4, PAGE), dtype=np.float32), np.zeros(2 * pages, dtype=np.int32)
            page[: self._used], following[: self._used] = (rows[: self._used] for rows in self._pages[3:])
            self._pages = self._pages._replace(page=page, following=following)


def build_capability_map(
    robot: RobotDescription,
    grid: Grid,
    construction: CapabilityConstruction,
    workers: int = 2,
    report: Callable[[CapabilityProgress], None] = lambda progress: None,
    unfinished: Path | None = None,
) -> CapabilityMap:
    """Build a robot's capability map until it holds `construction.target` orientations or brings few new ones.

    RichMap, Algorithm 1, on SO(3). Draw i comes from the seed (construction.seed, i) and draws are inserted in order,
    so the map is the same byte for byte whatever the number of workers, and whether or not the build was interrupted.

    Args:
        robot: The arm.
        grid: Cells in the arm's base frame.
        construction: Settings; what was reached is filled in.
        workers: Sampling processes.
        report: Called after each draw.
        unfinished: File that the map is kept in once a minute, that a later call goes on from, and that is deleted in
            the end.
    """
    limits = np.stack([robot.lower, robot.upper])
    inserter, reached = QuaternionInserter(grid, construction.theta), construction
    if unfinished and (left := _left_by_earlier_call(unfinished, grid, construction)):
        inserter.resume(left)
        reached = replace(left.construction, stop_rate=construction.stop_rate, target=construction.target)
    saved = time.monotonic()
    with worker_pool(workers) as pool:
        upcoming = (pool.submit(sample_orientations, robot, construction, i) for i in count(reached.draws))
        queue = deque(next(upcoming) for _ in range(2 * workers))
        while reached.batch_rate >= reached.stop_rate and not 0 < reached.target <= inserter.inserted:
            samples = queue.popleft().result()
            queue.append(next(upcoming))
            offered = inserter.offered
            stored = inserter.insert(samples)
            rate = float(stored.sum() / max(inserter.offered - offered, 1))
            reached = replace(reached, draws=reached.draws + 1, offered=inserter.offered, batch_rate=rate)
            report(CapabilityProgress(reached.draws, inserter.inserted, inserter.occupancy, rate))
            if unfinished and time.monotonic() - saved > SAVE_INTERVAL:
                CapabilityMap.from_rows(grid, *inserter.stored(), limits, reached).save(unfinished)
                saved = time.monotonic()
        pool.shutdown(cancel_futures=True)
    if unfinished:
        unfinished.unlink(missing_ok=True)
    return CapabilityMap.from_rows(grid, *inserter.stored(), limits, reached)


def sample_orientations(
    robot: RobotDescription, construction: CapabilityConstruction, index: int
) -> OrientationSamples:
    """Draw `index` of a build: free configurations, turned about joint 1 where they stay free, with full poses.

    Turning the last joint as well would give all rolls of a direction, but is not exact: 3 % of the Panda's free
    configurations collide with another value of it, .2 % of the Gen3's, .04 % of the UR5e's, none of the iiwa7's.
    """
    rng = np.random.default_rng((construction.seed, index))
    joints = sample_workspace(robot, rng, construction.draw, construction.turns).poses()[2].astype(np.float64)
    position, rotation = flange_frames(robot, joints)
    share = (joints - robot.lower) / (robot.upper - robot.lower)
    codes = np.rint(np.clip(share, 0, 1) * JOINT_STEPS).astype(np.uint16)
    return OrientationSamples(position.astype(np.float32), quaternions_of(rotation), codes)


def _left_by_earlier_call(file: Path, grid: Grid, construction: CapabilityConstruction) -> CapabilityMap | None:
    """The unfinished map of a file, if there is one that differs in nothing but in when to stop."""
    try:
        left = CapabilityMap.load(file)
    except (FileNotFoundError, FileRefusedError):
        return None
    own, names = left.construction, ("robot_fingerprint", "theta", "seed", "draw", "turns")
    same = left.grid == grid and all(getattr(own, name) == getattr(construction, name) for name in names)
    return left if same else None


@numba.njit(cache=True, inline="always", fastmath=True)
@no_type_check
def _near_stored(page, quaternion, pages, squared):
    w, x, y, z = quaternion
    while page >= 0:
        stored = pages.page[page]
        hits = np.int32(0)
        for k in range(stored.shape[1]):
            product = stored[0, k] * w + stored[1, k] * x + stored[2, k] * y + stored[3, k] * z
            hits += np.int32(product * product > squared)
        if hits > 0:
            return True
        page = pages.following[page]
    return False


@numba.njit(cache=True, nogil=True)
@no_type_check
def _insert_in_order(order, cells, quaternions, squared, stored, pages, used):
    """Insert poses one after the other; returns how many pages are then in use."""
    counts, first, last, page, following = pages
    for i in order:
        cell = cells[i]
        if _near_stored(first[cell], quaternions[i], pages, squared):
            continue
        lane = counts[cell] % PAGE
        if lane == 0:  # The cell's pages are full, or it has none yet.
            if counts[cell] == 0:
                first[cell] = used
            else:
                following[last[cell]] = used
            last[cell] = used
            following[used] = -1
            used += 1
        page[last[cell], :, lane] = quaternions[i]
        counts[cell] += 1
        stored[i] = True
    return used
