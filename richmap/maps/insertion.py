"""Greedy insertion of approach directions that keeps those stored in a cell at least theta apart."""

from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap
from pathlib import Path
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from richmap.geometry.direction_blocks import BLOCKS, BLOCKS_PER_EDGE
from richmap.geometry.directions import (
    ROUNDING,
    bin_of,
    bin_on_face,
    bins_per_edge,
    capacity_bound,
    code_of,
    decode,
    face_of,
    neighbour_bins,
)
from richmap.geometry.grid import Grid
from richmap.geometry.roll import FULL_CIRCLE, axis_at_roll, roll_about
from richmap.motion.sampling import Orbits


class Poses(NamedTuple):
    """Orbits as compiled loops read them, positions seen from their centre; cosine and sine of each turn in `turns`."""

    joints: Float[np.ndarray, "n dof"]
    position: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    gap_axis: Float[np.ndarray, "n 3"]
    free: Bool[np.ndarray, "n turns"]
    turns: Float[np.ndarray, "turns 2"]


class Bins(NamedTuple):
    """The table of direction bins of each cell, and how directions of it are compared."""

    table: UInt[np.ndarray, "cells bins"]
    """Code of the direction in a bin; 0 for none."""
    offsets: Int[np.ndarray, " bins1"]
    neighbours: Int[np.ndarray, " pairs"]
    """The bins that may hold a direction nearer than theta to one in bin b: `neighbours[offsets[b] : offsets[b + 1]]`,
    not a `Lists`, since Numba's parallel loops take no tuples in tuples."""
    per_edge: int
    """Bins along an edge of a cube's face."""
    cosine: np.float32
    """Directions with a greater one are too near to each other."""


class Rows(NamedTuple):
    """What is stored, by rows in order of insertion, and which cells and bins hold which rows."""

    slot: Int[np.ndarray, " rows"]
    """Cell and bin as one number."""
    joints: UInt[np.ndarray, "rows dof"]
    codes: UInt[np.ndarray, " rows"]
    gaps: UInt[np.ndarray, "rows_or_1 2"]
    """Start and width of the gap in the rolls, in steps of a full circle."""
    row: UInt[np.ndarray, "cells_or_1 bins_or_1"]
    """Row of each bin's direction, where rolls are tracked."""
    filled: Bool[np.ndarray, " cells"]
    lower: Float[np.ndarray, " dof"]
    """Lower joint limits, in [rad]."""
    step: Float[np.ndarray, " dof"]
    """A joint's range in 65,535 steps, in [rad]."""
    gap: int
    """Width of the gap that one configuration leaves, in steps of a full circle; 0 where rolls are not tracked."""


class Inserter:
    """A map under construction (RichMap, Algorithm 1): orbits in, theta-separated directions out.

    Each cell has a table of direction bins with the code of the one direction in it. A batch is inserted in two
    phases: all its poses against what is stored, in parallel; then the few that passed against each other, in order.
    The result is that of inserting pose after pose. A rejected pose adds the rolls that it can take to those of the
    stored direction that it was too near to (rotation range tracking).

    What is stored goes to files in a folder, by rows in order of insertion; a process that is killed leaves them there
    for `resume`. Tables are plain memory, of which the system gives what is touched.
    """

    def __init__(
        self,
        grid: Grid,
        theta: float,
        lower: Float[np.ndarray, " dof"],
        upper: Float[np.ndarray, " dof"],
        gap: float | None,
        folder: Path,
        device: str = "cpu",
    ) -> None:
        """An empty map.

        Args:
            grid: Cells in the arm's base frame.
            theta: Least angle between two directions of a cell, in [rad].
            lower: Lower joint limits, in [rad].
            upper: Upper joint limits, in [rad].
            gap: Width of the gap in the rolls that one configuration leaves out, in [rad] (`sampling.roll_gap`).
            folder: Where rows are kept.
            device: Where poses are compared with what is stored: cpu, or cuda for batched matrix products there.
        """
        self.grid, self.theta = grid, theta
        self.inserted = self.offered = 0
        gap_steps = round(gap / (2 * np.pi) * FULL_CIRCLE) if gap else 0
        per_edge = bins_per_edge(theta)
        bins = 6 * per_edge**2
        rows = grid.n_cells * min(int(capacity_bound(theta)), bins)
        folder.mkdir(parents=True, exist_ok=True)
        self._rows = Rows(
            _file_of_rows(folder / "slot", np.int64, (rows,)),
            _file_of_rows(folder / "joints", np.uint16, (rows, len(lower))),
            _file_of_rows(folder / "codes", np.uint32, (rows,)),
            _file_of_rows(folder / "gaps", np.uint16, (rows if gap_steps else 1, 2)),
            _small_pages((grid.n_cells, bins) if gap_steps else (1, 1)),
            np.zeros(grid.n_cells, dtype=bool),
            lower,
            (upper - lower) / 65535,
            gap_steps,
        )
        self._filled = self._rows.filled
        table, cosine = np.zeros((grid.n_cells, bins), dtype=np.uint32), np.float32(np.cos(theta) - ROUNDING)
        self._bins = Bins(table, *neighbour_bins(theta), per_edge, cosine)
        self._phase_1 = None
        if device != "cpu":
            from richmap.maps.torch_insertion import TorchPhase1

            self._phase_1 = TorchPhase1(grid, theta, device)

    @property
    def occupancy(self) -> float:
        """Fraction of cells that hold a direction."""
        return float(self._filled.mean())

    def resume(self, inserted: int, offered: int) -> None:
        """Go on after this many rows, which an earlier process left in the folder."""
        self.inserted, self.offered = inserted, offered
        table, rows = self._bins.table, self._rows
        slot = rows.slot[:inserted]
        table.ravel()[slot] = rows.codes[:inserted]
        if rows.gap:
            rows.row.ravel()[slot] = np.arange(inserted, dtype=np.uint32)
        rows.filled[slot // table.shape[1]] = True
        self._on_device(0, inserted)

    def insert(self, orbits: Orbits, target: int = 0) -> Bool[np.ndarray, "n turns"]:
        """Insert a batch; tells which of its poses were stored. Poses outside the grid never are.

        Args:
            orbits: The batch.
            target: Where to stop, in rows; what of the batch comes after is as if it had not been offered. 0: nowhere.
        """
        poses = _turned_poses(orbits)
        if self._phase_1:
            met, cells = self._phase_1.meet(orbits)
        else:
            seen = self.grid.moved(np.array([*orbits.centre, 0]))  # from the first axis, as the poses are
            met, cells = _meet_stored(poses, seen.cells, self._bins)
        stored, inserted = _insert_in_order(met, cells, poses, self._bins, self._rows, self.inserted, target or -1)
        if self._rows.gap:
            _add_rolls(met, stored, cells, poses, self._bins, self._rows)
        self._on_device(self.inserted, inserted)
        self.inserted = inserted
        self.offered += int((cells >= 0).sum())
        return stored

    def _on_device(self, first: int, last: int) -> None:
        """Tell the device of new rows."""
        if self._phase_1:
            slot, codes = self._rows.slot[first:last], self._rows.codes[first:last]
            bins = self._bins.table.shape[1]
            directions = _decode_rows(np.arange(len(slot)), slot, codes, bins, self._bins.per_edge**2)
            self._phase_1.store(slot // bins, directions, slot % bins)

    def insert_rows(
        self,
        cells: Int[np.ndarray, " n"],
        directions: Float[np.ndarray, "n 3"],
        joints: UInt[np.ndarray, "n dof"],
        gaps: UInt[np.ndarray, "n 2"] | None,
    ) -> None:
        """Insert what another map of the same arm, grid and theta has stored, row after row."""
        gaps = np.zeros((len(cells), 2), dtype=np.uint16) if gaps is None else gaps
        before = self.inserted
        self.inserted = _insert_rows(cells, directions, joints, gaps, self._bins, self._rows, self.inserted)
        self._on_device(before, self.inserted)

    def finish(
        self,
    ) -> tuple[
        Int[np.ndarray, " cells1"], Float[np.ndarray, "n 3"], UInt[np.ndarray, "n dof"], UInt[np.ndarray, "n 2"] | None
    ]:
        """First row of each cell, and direction, configuration and gap of each row, sorted by cell and block.

        Nothing can be inserted afterwards: the tables are given back, since fine maps fill half of a memory.
        """
        bins, per_face = self._bins.table.shape[1], self._bins.per_edge**2
        rows = self._rows
        slot, codes, joints, gaps = (x[: self.inserted] for x in (rows.slot, rows.codes, rows.joints, rows.gaps))
        tracked = rows.gap > 0
        del self._bins, self._rows, rows
        small = self.grid.n_cells * BLOCKS <= np.iinfo(np.int32).max
        keys = np.empty(len(slot), dtype=np.int32 if small else np.int64)
        _fill_keys(slot, codes, bins, per_face, keys)
        order = np.argsort(keys, kind="stable")
        del keys
        start = np.zeros(self.grid.n_cells + 1, dtype=np.int64)
        np.cumsum(np.bincount(slot // bins, minlength=self.grid.n_cells), out=start[1:])
        directions = _decode_rows(order, slot, codes, bins, per_face)
        return start, directions, joints[order], gaps[order] if tracked else None


def _file_of_rows(file: Path, dtype: type, shape: tuple[int, ...]) -> np.memmap:
    """A file of rows, as it is or new; what was not written takes no room on the disk."""
    return np.memmap(file, dtype, "r+" if file.exists() else "w+", shape=shape)


def _small_pages(shape: tuple[int, int]) -> UInt[np.ndarray, "cells bins"]:
    """Zeros that take a page of 4 kB where they are touched; NumPy's take 2 MB, for speed."""
    return np.frombuffer(mmap(-1, 4 * shape[0] * shape[1], flags=MAP_PRIVATE | MAP_ANONYMOUS), np.uint32).reshape(shape)


def _turned_poses(orbits: Orbits) -> Poses:
    angle = orbits.way * 2 * np.pi / orbits.turns * np.arange(orbits.turns)
    turns = np.stack([np.cos(angle), np.sin(angle)], 1).astype(np.float32)
    position = orbits.position - np.array([*orbits.centre, 0], dtype=np.float32)
    return Poses(orbits.joints, position, orbits.direction, orbits.gap_axis, orbits.free, turns)


@numba.njit(cache=True, inline="always")
@no_type_check
def _rounded(direction, c, s):
    """A turned direction as it would be stored: face, place on it, code, unit vector."""
    x, y, z = c * direction[0] - s * direction[1], s * direction[0] + c * direction[1], direction[2]
    face, u, v = face_of(x, y, z)
    code = code_of(u, v)
    x, y, z = decode(face, code)
    return face, u, v, code, x, y, z


@numba.njit(cache=True, inline="always")
@no_type_check
def _conflict(b, x, y, z, slots, bins):
    """A bin whose direction is too near, nearest bins first; -1 if there is none."""
    _, offsets, neighbours, n, cosine = bins
    if slots[b] != 0:
        return b
    for k in range(offsets[b], offsets[b + 1]):
        other = neighbours[k]
        code = slots[other]
        if code != 0:
            u, v, w = decode(other // (n * n), code)
            if u * x + v * y + w * z > cosine:
                return other
    return -1


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _meet_stored(poses, grid, bins):
    """Phase 1: the bin of a stored direction that each pose is too near to, -1 for none; and each pose's cell."""
    _, position, direction, _, free, turns = poses
    origin, cell_size, shape = grid
    met = np.full(free.shape, -1, dtype=np.int32)
    cells = np.full(free.shape, -1, dtype=np.int32)
    per_metre = 1 / cell_size
    for i in numba.prange(len(free)):
        k = int(np.floor((position[i, 2] - origin[2]) * per_metre))
        if k < 0 or k >= shape[2]:
            continue
        for t in range(free.shape[1]):
            if not free[i, t]:
                continue
            c, s = turns[t]
            x, y = c * position[i, 0] - s * position[i, 1], s * position[i, 0] + c * position[i, 1]
            ix = int(np.floor((x - origin[0]) * per_metre))
            iy = int(np.floor((y - origin[1]) * per_metre))
            if ix < 0 or iy < 0 or ix >= shape[0] or iy >= shape[1]:
                continue
            cell = (ix * shape[1] + iy) * shape[2] + k
            cells[i, t] = cell
            face, u, v, _, dx, dy, dz = _rounded(direction[i], c, s)
            b = bin_on_face(face, u, v, bins.per_edge)
            met[i, t] = _conflict(b, dx, dy, dz, bins.table[cell], bins)
    return met, cells


@numba.njit(cache=True, nogil=True)
@no_type_check
def _insert_in_order(met, cells, poses, bins, rows, inserted, target):
    """Phase 2: insert what met nothing, one after the other, unless one before was too near.

    From the target on, poses lose their cell: they count as not offered.
    """
    joints, _, direction, gap_axis, _, turns = poses
    table = bins.table
    slot, stored_joints, codes, gaps, row, filled, lower, step, gap = rows
    stored = np.zeros(met.shape, dtype=np.bool_)
    full_turn = 2 * np.pi
    for i in range(met.shape[0]):
        for t in range(met.shape[1]):
            if inserted == target:
                cells[i, t] = -1
            cell = cells[i, t]
            if cell < 0 or met[i, t] >= 0:
                continue
            face, u, v, code, x, y, z = _rounded(direction[i], turns[t, 0], turns[t, 1])
            b = bin_on_face(face, u, v, bins.per_edge)
            other = _conflict(b, x, y, z, table[cell], bins)
            met[i, t] = other
            if other >= 0:
                continue
            filled[cell] = True
            table[cell, b] = code
            slot[inserted] = cell * table.shape[1] + b
            codes[inserted] = code
            for j in range(joints.shape[1]):
                q = joints[i, j] - lower[j]
                if j == 0 and t > 0:
                    q = (q + full_turn * t / met.shape[1]) % full_turn
                    if q > 0.5 * (65535 * step[0] + full_turn):  # just below the lower limit, by rounding
                        q = 0.0
                stored_joints[inserted, j] = min(max(round(q / step[j]), 0), 65535)
            if gap > 0:
                row[cell, b] = inserted
                gaps[inserted, 0] = _roll(gap_axis[i], turns[t, 0], turns[t, 1], x, y, z)
                gaps[inserted, 1] = gap
            inserted += 1
            stored[i, t] = True
    return stored, inserted


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _add_rolls(met, stored, cells, poses, bins, rows):
    """Narrow the gap in the rolls of each direction that rejected a pose: what stays is in both of their gaps.

    Each thread takes the cells of one remainder, so that no two write to one gap. The order does not matter.
    """
    gap_axis, turns = poses.gap_axis, poses.turns
    table, n = bins.table, bins.per_edge
    row, gaps, gap = rows.row, rows.gaps, rows.gap
    parts = 8
    for part in numba.prange(parts):
        for i in range(met.shape[0]):
            for t in range(met.shape[1]):
                cell = cells[i, t]
                if cell < 0 or cell % parts != part or stored[i, t]:
                    continue
                b = met[i, t]
                entry = gaps[row[cell, b]]
                if entry[1] == 0:
                    continue
                x, y, z = decode(b // (n * n), table[cell, b])
                _narrow(entry, _roll(gap_axis[i], turns[t, 0], turns[t, 1], x, y, z), gap)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _insert_rows(cells, directions, joints, other_gaps, bins, rows, inserted):
    """Rows of another map; its gaps count from the canonical frames of its directions."""
    table, n = bins.table, bins.per_edge
    slot, stored_joints, codes, gaps, row, filled, _, _, gap = rows
    for i in range(len(cells)):
        cell = cells[i]
        face, u, v, code, x, y, z = _rounded(directions[i], np.float32(1), np.float32(0))
        b = bin_on_face(face, u, v, n)
        other = _conflict(b, x, y, z, table[cell], bins)
        if other < 0:
            filled[cell] = True
            table[cell, b] = code
            slot[inserted] = cell * table.shape[1] + b
            codes[inserted] = code
            stored_joints[inserted] = joints[i]
            if gap > 0:
                row[cell, b] = inserted
                gaps[inserted] = other_gaps[i]
            inserted += 1
        elif gap > 0 and gaps[row[cell, other], 1] > 0:
            ax, ay, az = axis_at_roll(other_gaps[i, 0], x, y, z)
            x, y, z = decode(other // (n * n), table[cell, other])
            _narrow(gaps[row[cell, other]], int(roll_about(ax, ay, az, x, y, z)) % FULL_CIRCLE, other_gaps[i, 1])
    return inserted


@numba.njit(cache=True, inline="always")
@no_type_check
def _narrow(entry, start, width):
    """Keep of a gap (start, width) what it shares with another one; both are less than half a circle wide."""
    half = FULL_CIRCLE // 2
    ahead = (int(start) - int(entry[0]) + half) % FULL_CIRCLE - half
    first = max(0, ahead)
    entry[1] = max(0, min(int(entry[1]), ahead + int(width)) - first)
    entry[0] = (int(entry[0]) + first) % FULL_CIRCLE


@numba.njit(cache=True, inline="always")
@no_type_check
def _roll(axis, c, s, x, y, z):
    """Roll of an axis, turned about base z, about the direction (x, y, z), in whole steps of a full circle."""
    return int(roll_about(c * axis[0] - s * axis[1], s * axis[0] + c * axis[1], axis[2], x, y, z)) % FULL_CIRCLE


@numba.njit(cache=True)
@no_type_check
def _fill_keys(slot, codes, bins, bins_per_face, keys):
    """Cell and block of each row as one number: the order in which `DirectionIndex` takes them as they are."""
    for i in range(len(slot)):
        x, y, z = decode(slot[i] % bins // bins_per_face, codes[i])
        keys[i] = slot[i] // bins * BLOCKS + bin_of(x, y, z, BLOCKS_PER_EDGE)


@numba.njit(cache=True)
@no_type_check
def _decode_rows(order, slot, codes, bins, bins_per_face):
    directions = np.empty((len(order), 3), dtype=np.float32)
    for i in range(len(order)):
        row = order[i]
        directions[i] = decode(slot[row] % bins // bins_per_face, codes[row])
    return directions
