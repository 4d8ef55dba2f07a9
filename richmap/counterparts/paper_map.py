"""The paper's own way to build and to ask a map: poses grouped by cell, and batched matrix products.

The slow twin of `richmap.maps.insertion` and `richmap.maps.direction_index`.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from richmap.geometry.grid import Grid
from richmap.maps.torch_insertion import StoredDirections, cells_of, groups_of_cells


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
        cell = cells_of(self.grid, torch.as_tensor(position, device=self.device))
        direction = torch.as_tensor(direction, device=self.device, dtype=torch.float32)
        order = torch.argsort(cell, stable=True)
        order = order[cell[order] >= 0]
        self.offered += len(order)
        slot = self._stored.open(cell[order])
        clear = self._stored.met(slot, direction[order]) < 0
        order, slot = order[clear], slot[clear]
        kept = _kept(slot, direction[order], self._stored.cosine)
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
        cell = cells_of(self.grid, torch.as_tensor(positions, device=self.device))
        query = torch.as_tensor(directions, device=self.device, dtype=torch.float32)
        count = torch.diff(self._start)
        order = torch.argsort(cell, stable=True)
        order = order[(cell[order] >= 0) & (count[cell[order]] > 0)]
        row = torch.full((len(cell),), -1, dtype=torch.int64, device=self.device)
        nearest = torch.full((len(cell),), -2.0, device=self.device)
        for pose, valid, of in groups_of_cells(cell[order], count, self.device.type):
            place = torch.arange(int(count[of].max()), device=self.device)
            stored = (self._start[of][:, None] + place).clamp(max=len(self._directions) - 1)
            cosine = torch.bmm(query[order[pose]], self._directions[stored].transpose(1, 2))
            cosine.masked_fill_((place >= count[of][:, None])[:, None, :], -2)
            best, at = cosine.max(2)
            nearest[order[pose[valid]]] = best[valid]
            row[order[pose[valid]]] = (self._start[of][:, None] + at)[valid]
        return row.cpu().numpy(), nearest.cpu().numpy()


def _kept(slot: Int[Tensor, " n"], direction: Float[Tensor, "n 3"], cosine: float) -> Bool[Tensor, " n"]:
    """Phase 2: which of some poses of sorted cells stay if they are taken one after the other."""
    kept = torch.zeros(len(slot), dtype=torch.bool, device=slot.device)
    for pose, valid, _ in groups_of_cells(slot, None, slot.device.type):
        vectors = direction[pose]
        near = torch.bmm(vectors, vectors.transpose(1, 2)) > cosine
        near &= valid[:, None, :] & valid[:, :, None]
        kept[pose[valid]] = _greedy(near, valid)[valid]
    return kept


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
