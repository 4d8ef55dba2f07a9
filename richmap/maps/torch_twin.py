"""The paper's own method: poses grouped by cell and compared with what is stored by batched matrix products.

It is the slow twin of `richmap.maps.insertion` and `richmap.maps.direction_index` on a CPU, and what runs on CUDA.
"""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from richmap.geometry.directions import ROUNDING
from richmap.geometry.grid import Grid
from richmap.motion.sampling import Orbits

PRODUCTS = {"cpu": 1 << 22, "cuda": 1 << 28}
"""Cosines that are computed at once on a kind of device, which bounds the memory."""


class StoredDirections:
    """The directions that each cell holds, on a device, in one table padded with zeros."""

    def __init__(self, grid: Grid, theta: float, device: torch.device) -> None:
        if not 0 < theta < np.pi / 2:
            raise ValueError(f"theta is {theta} rad; the padded products need it between 0 and pi / 2.")
        self.device, self.filled = device, 0
        self._cosine = float(np.float32(np.cos(theta) - ROUNDING))
        self._slot = torch.full((grid.n_cells,), -1, dtype=torch.int64, device=device)
        self._table = torch.zeros((1024, 64, 3), device=device)  # (filled cell, place, xyz)
        self._label = torch.zeros((1024, 64), dtype=torch.int32, device=device)
        self._count = torch.zeros(1024, dtype=torch.int64, device=device)

    def open(self, cell: Int[Tensor, " n"]) -> Int[Tensor, " n"]:
        """Row of the table for each of some sorted cells, opened where needed."""
        visited = torch.unique_consecutive(cell)
        new = visited[self._slot[visited] < 0]
        self._slot[new] = torch.arange(self.filled, self.filled + len(new), device=self.device)
        self.filled += len(new)
        while self.filled > len(self._count):
            for name in ("_table", "_label", "_count"):
                rows = getattr(self, name)
                setattr(self, name, torch.cat([rows, torch.zeros_like(rows)]))
        return self._slot[cell]

    def met(self, slot: Int[Tensor, " n"], direction: Float[Tensor, "n 3"]) -> Int[Tensor, " n"]:
        """Phase 1: label of the stored direction nearest to each pose if it is too near, -1 if none is.

        Args:
            slot: Rows of the table, sorted.
            direction: Unit vectors.
        """
        label = torch.full((len(slot),), -1, dtype=torch.int32, device=self.device)
        for pose, valid, of in _groups(slot, self._count[: self.filled], self.device.type):
            stored = self._table[of, : max(int(self._count[of].max()), 1)]
            cosine, place = torch.bmm(direction[pose], stored.transpose(1, 2)).max(2)  # (group, pose)
            of_nearest = torch.where(cosine > self._cosine, torch.take_along_dim(self._label[of], place, 1), -1)
            label[pose[valid]] = of_nearest[valid]
        return label

    def kept(self, slot: Int[Tensor, " n"], direction: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """Phase 2: which of some poses stay if they are taken one after the other; rows of the table, sorted."""
        kept = torch.zeros(len(slot), dtype=torch.bool, device=self.device)
        for pose, valid, _ in _groups(slot, None, self.device.type):
            vectors = direction[pose]
            near = torch.bmm(vectors, vectors.transpose(1, 2)) > self._cosine
            near &= valid[:, None, :] & valid[:, :, None]
            kept[pose[valid]] = _greedy(near, valid)[valid]
        return kept

    def store(self, slot: Int[Tensor, " n"], direction: Float[Tensor, "n 3"], label: Int[Tensor, " n"]) -> None:
        """Append directions with their labels to rows of the table; `slot` is sorted."""
        of, added = torch.unique_consecutive(slot, return_counts=True)
        first = torch.cumsum(added, 0) - added
        place = torch.arange(len(slot), device=self.device) - torch.repeat_interleave(first, added) + self._count[slot]
        self._count[of] += added
        while len(of) and int(self._count.max()) > self._table.shape[1]:
            self._table, self._label = (torch.cat([t, torch.zeros_like(t)], 1) for t in (self._table, self._label))
        self._table[slot, place] = direction
        self._label[slot, place] = label


class TorchPhase1:
    """What an `Inserter` with device="cuda" asks of the device: which poses of a batch meet a stored direction."""

    def __init__(self, grid: Grid, theta: float, device: str) -> None:
        self._grid, self._device = grid, torch.device(device)
        self._stored = StoredDirections(grid, theta, self._device)

    @torch.no_grad()
    def meet(self, orbits: Orbits) -> tuple[Int[np.ndarray, "n turns"], Int[np.ndarray, "n turns"]]:
        """Bin of the stored direction that each pose is too near to, -1 for none; and its cell, -1 outside the grid."""
        position, direction, free = (
            torch.as_tensor(np.ascontiguousarray(array), device=self._device)
            for array in (orbits.position, orbits.direction, orbits.free)
        )
        angle = orbits.way * 2 * np.pi / orbits.turns * torch.arange(orbits.turns, device=self._device)
        centre = torch.tensor([*orbits.centre, 0.0], device=self._device)
        position, direction = (_turned(vectors, angle.float()) for vectors in (position - centre, direction))
        position = position + centre  # (n, turns, 3)
        cell = torch.where(free.ravel(), _cells_of(self._grid, position.reshape(-1, 3)), -1)
        order = torch.argsort(cell, stable=True)
        order = order[cell[order] >= 0]
        met = torch.full_like(cell, -1, dtype=torch.int32)
        met[order] = self._stored.met(self._stored.open(cell[order]), direction.reshape(-1, 3)[order])
        shape = orbits.free.shape
        return met.cpu().numpy().reshape(shape), cell.int().cpu().numpy().reshape(shape)

    @torch.no_grad()
    def store(
        self, cells: Int[np.ndarray, " n"], directions: Float[np.ndarray, "n 3"], bins: Int[np.ndarray, " n"]
    ) -> None:
        """Take over what was stored meanwhile."""
        cell = torch.as_tensor(cells, device=self._device).long()
        order = torch.argsort(cell, stable=True)
        direction, label = (torch.as_tensor(rows, device=self._device)[order] for rows in (directions, bins))
        self._stored.store(self._stored.open(cell[order]), direction, label.int())


class TorchInserter:
    """A map under construction on a torch device (RichMap, Algorithm 1); the twin of `Inserter`.

    A batch is sorted by cell with a stable sort. Phase 1 compares its poses with the directions of their cells, which
    are kept in one padded table; phase 2 those that passed with each other. The result is that of inserting pose
    after pose, but for cosines within float32 rounding of the threshold.
    """

    def __init__(self, grid: Grid, theta: float, dof: int, device: str) -> None:
        self.grid, self.theta, self.device = grid, theta, torch.device(device)
        self.offered = 0
        self._stored = StoredDirections(grid, theta, self.device)
        self._cells = [torch.empty(0, dtype=torch.int64, device=self.device)]
        self._directions = [torch.empty((0, 3), device=self.device)]
        self._joints = [torch.empty((0, dof), device=self.device)]

    @torch.no_grad()
    def insert(
        self,
        position: Float[np.ndarray, "n 3"] | Float[Tensor, "n 3"],
        direction: Float[np.ndarray, "n 3"] | Float[Tensor, "n 3"],
        joints: Float[np.ndarray, "n dof"] | Float[Tensor, "n dof"],
    ) -> Bool[np.ndarray, " n"]:
        """Insert a batch; tells which of its poses were stored. Poses outside the grid never are."""
        cell = _cells_of(self.grid, torch.as_tensor(position, device=self.device))
        direction = torch.as_tensor(direction, device=self.device, dtype=torch.float32)
        order = torch.argsort(cell, stable=True)
        order = order[cell[order] >= 0]
        self.offered += len(order)
        slot = self._stored.open(cell[order])
        clear = self._stored.met(slot, direction[order]) < 0
        order, slot = order[clear], slot[clear]
        kept = self._stored.kept(slot, direction[order])
        order, slot = order[kept], slot[kept]
        self._stored.store(slot, direction[order], torch.zeros_like(slot).int())
        by_time = torch.sort(order).values
        self._cells.append(cell[by_time])
        self._directions.append(direction[by_time])
        self._joints.append(torch.as_tensor(joints, device=self.device, dtype=torch.float32)[by_time])
        mask = np.zeros(len(position), dtype=bool)
        mask[order.cpu().numpy()] = True
        return mask

    @torch.no_grad()
    def resume(
        self, cell: Int[np.ndarray, " n"], direction: Float[np.ndarray, "n 3"], joints: Float[np.ndarray, "n dof"]
    ) -> None:
        """Take over what another inserter has `stored` in cells that hold nothing yet; nothing is compared."""
        cells, directions, configurations = (torch.tensor(x, device=self.device) for x in (cell, direction, joints))
        order = torch.argsort(cells, stable=True)
        self._stored.store(self._stored.open(cells[order]), directions[order].float(), torch.zeros_like(order).int())
        self._cells.append(cells.long())
        self._directions.append(directions.float())
        self._joints.append(configurations.float())

    def stored(self) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n dof"]]:
        """Cell, direction and configuration of all that is stored, in order of insertion."""
        for rows in (self._cells, self._directions, self._joints):
            rows[:] = [torch.cat(rows)]
        cell, direction, joints = (rows[0].cpu().numpy() for rows in (self._cells, self._directions, self._joints))
        return cell, direction, joints

    @property
    def inserted(self) -> int:
        """Number of stored directions."""
        return sum(map(len, self._cells))

    @property
    def filled_cells(self) -> int:
        """Number of cells that hold at least one direction: the first one offered to a cell always stays."""
        return self._stored.filled


class TorchNearest:
    """Nearest stored direction by batched matrix products; the twin of `DirectionIndex.nearest`."""

    def __init__(
        self, grid: Grid, start: Int[np.ndarray, " cells1"], directions: Float[np.ndarray, "n 3"], device: str
    ) -> None:
        self.grid, self.device = grid, torch.device(device)
        self._start = torch.tensor(start, device=self.device)  # a copy: a map's arrays are read-only
        self._directions = torch.tensor(directions, device=self.device)

    @torch.no_grad()
    def __call__(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Nearest stored direction in the cell of each pose.

        Returns:
            Row of the map (-1 where the cell is empty or outside the grid), and the cosine of the angle to it (-2
            where there is none). Of directions that are equally near to within rounding it may name any.
        """
        cell = _cells_of(self.grid, torch.as_tensor(positions, device=self.device))
        query = torch.as_tensor(directions, device=self.device, dtype=torch.float32)
        count = torch.diff(self._start)
        order = torch.argsort(cell, stable=True)
        order = order[(cell[order] >= 0) & (count[cell[order]] > 0)]
        row = torch.full((len(cell),), -1, dtype=torch.int64, device=self.device)
        nearest = torch.full((len(cell),), -2.0, device=self.device)
        for pose, valid, of in _groups(cell[order], count, self.device.type):
            place = torch.arange(int(count[of].max()), device=self.device)
            stored = (self._start[of][:, None] + place).clamp(max=len(self._directions) - 1)
            cosine = torch.bmm(query[order[pose]], self._directions[stored].transpose(1, 2))
            cosine.masked_fill_((place >= count[of][:, None])[:, None, :], -2)
            best, at = cosine.max(2)
            nearest[order[pose[valid]]] = best[valid]
            row[order[pose[valid]]] = (self._start[of][:, None] + at)[valid]
        return row.cpu().numpy(), nearest.cpu().numpy()


def _turned(vectors: Float[Tensor, "n 3"], angle: Float[Tensor, " turns"]) -> Float[Tensor, "n turns 3"]:
    """Vectors turned about the z axis."""
    c, s = torch.cos(angle), torch.sin(angle)
    x, y, z = vectors[:, :, None].unbind(1)
    return torch.stack([c * x - s * y, s * x + c * y, z.expand(-1, len(angle))], 2)


def _cells_of(grid: Grid, position: Float[Tensor, "n 3"]) -> Int[Tensor, " n"]:
    """`Grid.cells_of` on a device: flat index of the cell that holds each point; -1 outside the grid."""
    origin, shape = (torch.tensor(values, device=position.device) for values in (grid.origin, grid.shape))
    index = torch.floor((position.double() - origin.double()) / grid.cell_size).long()
    inside = ((index >= 0) & (index < shape)).all(1)
    flat = (index[:, 0] * grid.shape[1] + index[:, 1]) * grid.shape[2] + index[:, 2]
    return torch.where(inside, flat, -1)


def _groups(
    cell: Int[Tensor, " n"], stored: Int[Tensor, " cells"] | None, kind: str
) -> Iterator[tuple[Int[Tensor, "group pose"], Bool[Tensor, "group pose"], Int[Tensor, " group"]]]:
    """Sorted cells in groups of similar size, as many together as one product may take.

    Args:
        cell: Of each pose, sorted.
        stored: What each cell holds, to be compared with its poses; None if they are compared with each other.
        kind: Of the device.

    Yields:
        Rows of `cell` per group, padded; which of them are no padding; the groups' cells.
    """
    if len(cell) == 0:
        return
    of, count = torch.unique_consecutive(cell, return_counts=True)
    first = torch.cumsum(count, 0) - count
    width = count if stored is None else stored[of]
    order = torch.argsort(count * width.clamp(min=1))  # so that little is padding
    heights, widths = count[order].cpu().numpy(), width.clamp(min=1)[order].cpu().numpy()
    begin = 0
    while begin < len(order):
        ahead = slice(begin, begin + PRODUCTS[kind])
        tall, broad = np.maximum.accumulate(heights[ahead]), np.maximum.accumulate(widths[ahead])
        cost = np.arange(1, len(tall) + 1) * tall * broad
        groups = max(int(np.searchsorted(cost, PRODUCTS[kind], side="right")), 1)
        end, height = begin + groups, int(tall[groups - 1])
        group = order[begin:end]
        place = torch.arange(height, device=cell.device)
        valid = place < count[group][:, None]
        yield torch.where(valid, first[group][:, None] + place, first[group][:, None]), valid, of[group]
        begin = end


def _greedy(near: Bool[Tensor, "group pose pose"], valid: Bool[Tensor, "group pose"]) -> Bool[Tensor, "group pose"]:
    """What taking pose after pose keeps, unless one before was too near, in few rounds over all groups at once.

    A pose is kept once none before it that is too near is undecided or kept (Blelloch et al., "Greedy Sequential
    Maximal Independent Set and Matching Are Parallel on Average", SPAA 2012).
    """
    before = torch.tril(near, -1).float()
    kept, undecided = torch.zeros_like(valid), valid.clone()
    while bool(undecided.any()):
        blocked = torch.bmm(before, undecided.float()[:, :, None])[:, :, 0] > 0
        kept |= undecided & ~blocked
        too_near = torch.bmm(before, kept.float()[:, :, None])[:, :, 0] > 0
        undecided &= ~kept & ~too_near
    return kept
