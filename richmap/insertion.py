"""Greedy insertion of approach directions that keeps those stored in a cell at least theta apart."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int

from richmap.directions import bin_of, bins_per_edge, neighbour_bins
from richmap.grid import Grid
from richmap.sampling import WorkspaceSamples

EMPTY = -1


class Inserter:
    """A map under construction (RichMap, Algorithm 1): batches in, theta-separated directions out.

    Each cell that holds anything has a table of direction bins, each with the row of the one direction in it. A
    batch is inserted in two phases: all its poses against what is stored, in parallel; then the few that passed
    against each other, in order. The result is that of inserting pose after pose.
    """

    def __init__(self, grid: Grid, theta: float, dof: int) -> None:
        self.grid, self.theta = grid, theta
        self.inserted = self.offered = 0
        self._n = bins_per_edge(theta)
        self._block_of_cell = np.full(grid.n_cells, EMPTY, dtype=np.int32)
        self._blocks = 0
        self._table = np.full((1024, 6 * self._n**2), EMPTY, dtype=np.int32)
        self._cell = np.empty(1 << 20, dtype=np.int32)
        self._direction = np.empty((1 << 20, 3), dtype=np.float32)
        self._joints = np.empty((1 << 20, dof), dtype=np.float32)

    def insert(self, samples: WorkspaceSamples) -> Bool[np.ndarray, " n"]:
        """Insert a batch; tells which of its poses were stored. Poses outside the grid never are."""
        cell = self.grid.cells_of(samples.position)
        blocks = self._open_blocks(cell)
        near = neighbour_bins(self.theta)
        cosine = np.float32(np.cos(self.theta))
        candidates = np.flatnonzero(
            _clear_of_stored(blocks, samples.direction, self._table, self._direction, *near, self._n, cosine)
        )
        self._reserve(self.inserted + len(candidates))
        stored = _insert_in_order(
            candidates, blocks, cell, samples.direction, samples.joints, self.inserted,
            self._table, self._cell, self._direction, self._joints, *near, self._n, cosine,
        )  # fmt: skip
        self.inserted += int(stored.sum())
        self.offered += int((cell >= 0).sum())
        mask = np.zeros(len(cell), dtype=bool)
        mask[candidates[stored]] = True
        return mask

    def stored(self) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n dof"]]:
        """Cell, direction and configuration of all that is stored, in order of insertion."""
        n = self.inserted
        return self._cell[:n], self._direction[:n], self._joints[:n]

    @property
    def filled_cells(self) -> int:
        """Number of cells that hold at least one direction: the first one offered to a cell always stays."""
        return self._blocks

    def _open_blocks(self, cell: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Row of `_table` for each pose's cell, opened where needed; -1 outside the grid."""
        visited = np.unique(cell[cell >= 0])
        new = visited[self._block_of_cell[visited] == EMPTY]
        while self._blocks + len(new) > len(self._table):
            self._table = np.concatenate([self._table, np.full_like(self._table, EMPTY)])
        self._block_of_cell[new] = np.arange(self._blocks, self._blocks + len(new))
        self._blocks += len(new)
        return np.where(cell >= 0, self._block_of_cell[cell], EMPTY)

    def _reserve(self, rows: int) -> None:
        while rows > len(self._cell):
            self._cell = np.concatenate([self._cell, np.empty_like(self._cell)])
            self._direction = np.concatenate([self._direction, np.empty_like(self._direction)])
            self._joints = np.concatenate([self._joints, np.empty_like(self._joints)])


@numba.njit(cache=True, inline="always")
@no_type_check
def _conflicts(b, x, y, z, slots, direction, offsets, neighbours, cosine):
    if slots[b] >= 0:
        return True
    for k in range(offsets[b], offsets[b + 1]):
        row = slots[neighbours[k]]
        if row >= 0:
            if direction[row, 0] * x + direction[row, 1] * y + direction[row, 2] * z > cosine:
                return True
    return False


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _clear_of_stored(blocks, directions, table, stored, offsets, neighbours, n, cosine):
    """Phase 1: which poses of a batch are at least theta from everything stored in their cell."""
    clear = np.zeros(len(blocks), dtype=np.bool_)
    for i in numba.prange(len(blocks)):
        if blocks[i] >= 0:
            x, y, z = directions[i]
            b = bin_of(x, y, z, n)
            clear[i] = not _conflicts(b, x, y, z, table[blocks[i]], stored, offsets, neighbours, cosine)
    return clear


@numba.njit(cache=True, nogil=True)
@no_type_check
def _insert_in_order(
    candidates,
    blocks,
    cells,
    directions,
    joints,
    rows,
    table,
    cell,
    direction,
    joint,
    offsets,
    neighbours,
    n,
    cosine,
):
    """Phase 2: insert the candidates one after the other, unless one before them was too near."""
    stored = np.zeros(len(candidates), dtype=np.bool_)
    for c in range(len(candidates)):
        i = candidates[c]
        x, y, z = directions[i]
        b = bin_of(x, y, z, n)
        slots = table[blocks[i]]
        if not _conflicts(b, x, y, z, slots, direction, offsets, neighbours, cosine):
            slots[b] = rows
            cell[rows] = cells[i]
            direction[rows] = directions[i]
            joint[rows] = joints[i]
            rows += 1
            stored[c] = True
    return stored
