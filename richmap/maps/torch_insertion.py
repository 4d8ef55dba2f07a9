"""Poses compared with what a map under construction stores by batched matrix products, as the paper does: on CUDA."""

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
    """The directions that each cell holds, on a device, in one table padded with zeros.

    Directions whose cosine is above `cosine` are too near to each other.
    """

    def __init__(self, grid: Grid, theta: float, device: torch.device) -> None:
        if not 0 < theta < np.pi / 2:
            raise ValueError(f"theta is {theta} rad; the padded products need it between 0 and pi / 2.")
        self.device, self.filled = device, 0
        self.cosine = float(np.float32(np.cos(theta) - ROUNDING))
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
        """Label of the stored direction nearest to each pose if it is too near, -1 if none is.

        Args:
            slot: Rows of the table, sorted.
            direction: Unit vectors.
        """
        label = torch.full((len(slot),), -1, dtype=torch.int32, device=self.device)
        for pose, valid, of in groups_of_cells(slot, self._count[: self.filled], self.device.type):
            stored = self._table[of, : max(int(self._count[of].max()), 1)]
            cosine, place = torch.bmm(direction[pose], stored.transpose(1, 2)).max(2)  # (group, pose)
            of_nearest = torch.where(cosine > self.cosine, torch.take_along_dim(self._label[of], place, 1), -1)
            label[pose[valid]] = of_nearest[valid]
        return label

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
        cell = torch.where(free.ravel(), cells_of(self._grid, position.reshape(-1, 3)), -1)
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


def _turned(vectors: Float[Tensor, "n 3"], angle: Float[Tensor, " turns"]) -> Float[Tensor, "n turns 3"]:
    """Vectors turned about the z axis."""
    c, s = torch.cos(angle), torch.sin(angle)
    x, y, z = vectors[:, :, None].unbind(1)
    return torch.stack([c * x - s * y, s * x + c * y, z.expand(-1, len(angle))], 2)


def cells_of(grid: Grid, position: Float[Tensor, "n 3"]) -> Int[Tensor, " n"]:
    """`Grid.cells_of` on a device: flat index of the cell that holds each point; -1 outside the grid."""
    origin, shape = (torch.tensor(values, device=position.device) for values in (grid.origin, grid.shape))
    index = torch.floor((position.double() - origin.double()) / grid.cell_size).long()
    inside = ((index >= 0) & (index < shape)).all(1)
    flat = (index[:, 0] * grid.shape[1] + index[:, 1]) * grid.shape[2] + index[:, 2]
    return torch.where(inside, flat, -1)


def groups_of_cells(
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
