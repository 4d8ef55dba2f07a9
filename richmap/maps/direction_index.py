"""The stored direction nearest to a pose's, exactly, without looking through all that its cell holds."""

from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from richmap.geometry.checked_poses import checked_poses, read_only
from richmap.geometry.direction_blocks import (
    BINS_PER_EDGE,
    BLOCKS,
    BLOCKS_PER_EDGE,
    blocks_outwards,
    runs_within,
)
from richmap.geometry.directions import bin_of
from richmap.geometry.grid import Grid

NEAR = 0.1
"""The angle within which the nearest direction is looked for first, in [rad]; a full map has one there (theta)."""

EMPTY = -1

PART = 1 << 20
"""At most so many queries are put in the order of cells at once, so that what a cell holds is read from memory once."""


class Stored(NamedTuple):
    """What compiled loops read of an index; the fields are those of `DirectionIndex`."""

    slot: Int[np.ndarray, " cells"]
    start: Int[np.ndarray, " filled"]
    offsets: UInt[np.ndarray, "filled blocks1"]
    directions: Float[np.ndarray, "n 3"]
    rows: Int[np.ndarray, " m"]


@dataclass(frozen=True)
class DirectionIndex:
    """The directions of a map, of each cell by blocks of the sphere.

    A search looks through the few blocks that lie within 0.1 rad of the pose's direction. If none of their directions
    is that near, it visits all blocks outwards and ends where no block can hold a nearer one. Answers are those of a
    scan of the whole cell, bit for bit: the same float32 dot products, and of equally near directions the first.
    """

    grid: Grid
    slot: Int[np.ndarray, " cells"]
    """For each cell its number among the filled ones; -1 for an empty one."""
    start: Int[np.ndarray, " filled"]
    """For each filled cell the place of its first direction."""
    offsets: UInt[np.ndarray, "filled blocks1"]
    """Within a filled cell, the places of block b are `offsets[b]` to `offsets[b + 1]`, from the cell's first."""
    directions: Float[np.ndarray, "n 3"]
    """Unit vectors by cell and block."""
    rows: Int[np.ndarray, " m"]
    """For each place the row of the map; empty if the map's rows are in this order already."""

    @classmethod
    def build(
        cls, grid: Grid, start: Int[np.ndarray, " cells1"], directions: Float[np.ndarray, "n 3"]
    ) -> "DirectionIndex":
        """Index directions that are sorted by cell.

        Args:
            grid: The map's cells.
            start: Directions of flat cell c are rows `start[c]` to `start[c + 1]`.
            directions: Unit vectors, float32. They are kept, not copied, where each cell's are sorted by `block_of`.

        Raises:
            ValueError: If a cell holds more than 65,535 directions.
        """
        count = np.diff(start)
        if count.max(initial=0) > np.iinfo(np.uint16).max:
            raise ValueError(
                f"A cell holds {count.max()} directions; the index takes up to 65535. Take a larger theta."
            )
        directions, cells = read_only(directions[: start[-1]]), np.flatnonzero(count)
        slot = np.full(grid.n_cells, EMPTY, dtype=np.int32)
        slot[cells] = np.arange(len(cells), dtype=np.int32)
        first, last = start[cells], start[cells + 1]
        offsets, in_order = _count_blocks(first, last, directions)
        rows = np.empty(0, dtype=np.int32)
        if not in_order.all():
            rows = _sort_by_block(first, last, directions, offsets)
            directions = read_only(directions[rows])
        return cls(grid, slot, first, offsets, directions, rows)

    def nearest(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Nearest stored direction in the cell of each pose.

        Args:
            positions: In the map's frame, in [m].
            directions: Unit vectors in the map's frame; float32 is taken as it is.

        Returns:
            Row of the map (-1 where the cell is empty or outside the grid), and the cosine of the angle to it (-2
            where there is none).

        Raises:
            ValueError: If the shapes are not (n, 3), or a direction is no unit vector.
        """
        positions, directions = checked_poses(positions, directions)
        directions = directions.astype(np.float32, copy=False)
        part, cosine = _part_size(len(directions)), np.float32(np.cos(NEAR))
        near = runs_within(NEAR)
        return _nearest(positions, directions, part, self.grid.cells, self.stored, cosine, near, blocks_outwards())

    def within(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], angle: float
    ) -> Bool[np.ndarray, " n"]:
        """Whether the cell of each pose holds a direction nearer than `angle`, in [rad]; outside the grid never.

        Nearer is what the `Inserter` takes for it: the cosine in float32 is above that of `angle`.
        """
        positions, directions = checked_poses(positions, directions)
        directions = directions.astype(np.float32, copy=False)
        part, cosine = _part_size(len(directions)), np.float32(np.cos(angle))
        return _within(positions, directions, part, self.grid.cells, self.stored, cosine, runs_within(angle))

    @property
    def nbytes(self) -> int:
        """Memory in bytes, the directions included."""
        arrays = self.slot, self.start, self.offsets, self.directions, self.rows
        return sum(array.nbytes for array in arrays)

    @property
    def stored(self) -> Stored:
        """What compiled loops read."""
        return Stored(self.slot, self.start, self.offsets, self.directions, self.rows)


def _part_size(queries: int) -> int:
    """How many queries a thread takes at once."""
    return min(PART, max(-(-queries // numba.get_num_threads()), 1))


@numba.njit(cache=True, inline="always", error_model="numpy")
@no_type_check
def cell_of(x, y, z, cells):
    """Flat index of the cell that holds a point; -1 outside the grid (`Grid.cells_of`)."""
    origin, cell_size, shape = cells
    i = np.floor((x - origin[0]) / cell_size)
    j = np.floor((y - origin[1]) / cell_size)
    k = np.floor((z - origin[2]) / cell_size)
    inside = (i >= 0) & (j >= 0) & (k >= 0) & (i < shape[0]) & (j < shape[1]) & (k < shape[2])
    return np.int64((i * shape[1] + j) * shape[2] + k) if inside else np.int64(-1)


@numba.njit(cache=True, inline="always", error_model="numpy")
@no_type_check
def _slot_of(point, cells, slot):
    cell = cell_of(point[0], point[1], point[2], cells)
    return slot[cell] if cell >= 0 else EMPTY


@numba.njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _by_slot(positions, cells, stored):
    """Slot of each position, and an order in which those of a cell are together; empty cells are left out."""
    slots, filled = np.empty(len(positions), dtype=np.int32), len(stored.start)
    n = 0
    for i in range(len(positions)):
        slots[i] = _slot_of(positions[i], cells, stored.slot)
        n += slots[i] >= 0
    order = np.empty(n, dtype=np.int32)
    place = np.zeros(filled + 1, dtype=np.int32)
    if len(positions) < filled:
        n = 0
        for i in range(len(positions)):
            if slots[i] >= 0:
                order[n] = i
                n += 1
        return slots, order
    for i in range(len(positions)):
        place[slots[i] + 1] += slots[i] >= 0
    place[0] = 0
    for s in range(filled):
        place[s + 1] += place[s]
    for i in range(len(positions)):
        s = slots[i]
        if s >= 0:
            order[place[s]] = i
            place[s] += 1
    return slots, order


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _nearest(positions, queries, size, cells, stored, near_cosine, runs, outwards):
    _, start, offsets, directions, rows = stored
    found = np.full(len(queries), -1, dtype=np.int64)
    cosines = np.full(len(queries), -2.0, dtype=np.float32)
    for part in numba.prange((len(queries) + size - 1) // size):
        begin, end = part * size, min((part + 1) * size, len(queries))
        slots, sequence = _by_slot(positions[begin:end], cells, stored)
        # Fetched before and written after the search, so that its branches do not wait for scattered memory.
        ordered, slots = queries[begin:end][sequence], slots[sequence]
        nearest, cosine = np.empty(len(sequence), dtype=np.int64), np.empty(len(sequence), dtype=np.float32)
        for n in range(len(sequence)):
            s = slots[n]
            x, y, z = ordered[n]
            place, best, tied = _search_near(x, y, z, start[s], offsets[s], directions, runs)
            if best <= near_cosine:
                place, best, tied = _search(x, y, z, best, start[s], offsets[s], directions, outwards)
            if tied:
                place = _first_of(x, y, z, best, start[s], start[s] + offsets[s, BLOCKS], directions, rows)
            nearest[n], cosine[n] = place, best
        for n in range(len(sequence)):
            i = begin + sequence[n]
            found[i] = rows[nearest[n]] if len(rows) else nearest[n]
            cosines[i] = cosine[n]
    return found, cosines


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _search_near(x, y, z, begin, offsets, directions, runs):
    """Place of the nearest direction in the blocks close by, the cosine, and whether another one is as near."""
    b = bin_of(x, y, z, BINS_PER_EDGE)
    best, nearest, tied = np.float32(-2), begin, False
    for k in range(runs.offsets[b], runs.offsets[b + 1]):
        for place in range(begin + offsets[runs.lists[k, 0]], begin + offsets[runs.lists[k, 1]]):
            cosine = x * directions[place, 0] + y * directions[place, 1] + z * directions[place, 2]
            nearer = cosine > best
            tied = (cosine == best) | (tied & (not nearer))
            best = cosine if nearer else best
            nearest = place if nearer else nearest
    return nearest, best, tied


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _search(x, y, z, known, begin, offsets, directions, outwards):
    """The same among all directions of a cell; `known` is a cosine that one of them has, or -2."""
    centre, cr, sr, order, limit = outwards
    b = bin_of(x, y, z, BLOCKS_PER_EDGE)
    best, nearest, tied = np.float32(-2), begin, False
    enough = _least_cosine(known, cr, sr)
    for k in range(BLOCKS):
        if known > limit[b, k]:
            break
        t = order[b, k]
        first, last = offsets[t], offsets[t + 1]
        if (first == last) | (x * centre[t, 0] + y * centre[t, 1] + z * centre[t, 2] < enough):
            continue
        for place in range(begin + first, begin + last):
            cosine = x * directions[place, 0] + y * directions[place, 1] + z * directions[place, 2]
            nearer = cosine > best
            tied = (cosine == best) | (tied & (not nearer))
            best = cosine if nearer else best
            nearest = place if nearer else nearest
        if best > known:
            known, enough = best, _least_cosine(best, cr, sr)
    return nearest, best, tied


@numba.njit(cache=True, inline="always", error_model="numpy")
@no_type_check
def _least_cosine(best, cr, sr):
    """A block whose centre has a smaller cosine holds no direction with a cosine above `best`: angles add up."""
    sine = np.sqrt(max(np.float32(1) - best * best, np.float32(0)))
    return best * cr - sine * sr - np.float32(1e-6) if best > -cr else np.float32(-2)


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _first_of(x, y, z, best, begin, end, directions, rows):
    """Of a cell's equally near directions the place of the one that is first in the map."""
    found = np.int64(-1)
    for place in range(begin, end):
        if x * directions[place, 0] + y * directions[place, 1] + z * directions[place, 2] == best:
            if found < 0 or (len(rows) and rows[place] < rows[found]):
                found = place
    return found


@numba.njit(cache=True, inline="always", error_model="numpy")
@no_type_check
def any_within(x, y, z, begin, offsets, directions, cosine, runs):
    """Whether one of a cell's directions has a cosine with (x, y, z) above `cosine`, the one of the runs' angle."""
    b = bin_of(x, y, z, BINS_PER_EDGE)
    for k in range(runs.offsets[b], runs.offsets[b + 1]):
        for place in range(begin + offsets[runs.lists[k, 0]], begin + offsets[runs.lists[k, 1]]):
            if x * directions[place, 0] + y * directions[place, 1] + z * directions[place, 2] > cosine:
                return True
    return False


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _within(positions, queries, size, cells, stored, cosine, runs):
    _, start, offsets, directions, _ = stored
    found = np.zeros(len(queries), dtype=np.bool_)
    for part in numba.prange((len(queries) + size - 1) // size):
        begin, end = part * size, min((part + 1) * size, len(queries))
        slots, sequence = _by_slot(positions[begin:end], cells, stored)
        ordered, slots = queries[begin:end][sequence], slots[sequence]
        for n in range(len(sequence)):
            s = slots[n]
            x, y, z = ordered[n]
            found[begin + sequence[n]] = any_within(x, y, z, start[s], offsets[s], directions, cosine, runs)
    return found


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _count_blocks(first, last, directions):
    """Offsets of each cell's blocks, and whether its directions are sorted by block."""
    offsets = np.zeros((len(first), BLOCKS + 1), dtype=np.uint16)
    in_order = np.ones(len(first), dtype=np.bool_)
    for c in numba.prange(len(first)):
        before = 0
        for row in range(first[c], last[c]):
            x, y, z = directions[row]
            b = bin_of(x, y, z, BLOCKS_PER_EDGE)
            offsets[c, b + 1] += 1
            in_order[c] &= b >= before
            before = b
        for b in range(BLOCKS):
            offsets[c, b + 1] += offsets[c, b]
    return offsets, in_order


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _sort_by_block(first, last, directions, offsets):
    """Rows by cell and block; within a block their order is kept."""
    rows = np.empty(len(directions), dtype=np.int32)
    for c in numba.prange(len(first)):
        place = offsets[c].astype(np.int64)
        for row in range(first[c], last[c]):
            x, y, z = directions[row]
            b = bin_of(x, y, z, BLOCKS_PER_EDGE)
            rows[first[c] + place[b]] = row
            place[b] += 1
    return rows
