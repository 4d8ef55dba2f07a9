"""Ways along which an arm can push a block to its target: how much of them is left from anywhere."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from envs.arm.feasibility import TableFeasibility

CELL = 0.01
"""Of the grid of block positions, in [m]."""
BORDER = 0.05
"""The grid goes this far beyond the feasibility's, in [m]: blocks may lie where no pusher can be."""
HEADINGS = np.array([(i, j) for i, j in product(range(-2, 3), repeat=2) if np.gcd(i, j) == 1])
"""Directions in which blocks are pushed, in cells: sixteen, about 22 degrees apart."""
BEHIND = 0.027
"""From a block's centre to a pusher that pushes it, in [m]."""
TURN, REGRIP = 0.01, 0.08
"""Cost of going on in a neighbouring direction, and in another one, in [m] of pushing."""
NARROW, ROOMY = 2.0, 0.03
"""Pushing at the very edge of what the arm can do costs so much more, and as usual this far from it, in [m]."""
LOST, LOST_SLOPE = 1.0, 5.0
"""Where no way leads from, a block has this much left, in [m] of pushing, and so many times the distance from there to
where one does."""
FACING, TURNED = np.radians(15), 0.5
"""A block is pushed well along a heading when one of its faces is turned away from it by no more than this, in [rad];
beyond that it costs this much, in [m] of pushing per [rad^2]."""
PLACED = 0.03
"""Ways end this near to the target's centre, in [m]."""


@dataclass(frozen=True)
class BlockWays:
    """Shortest ways of pushing a block straight ahead, turn after turn, with the pusher always where the arm can be."""

    table: TableFeasibility
    target: Float[np.ndarray, "2"]
    """Centre of the target, in [m]."""

    def left(self, blocks: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """What is left from poses (x, y in [m], yaw in [rad]), in [m] of pushing; from `LOST` on there is no way."""
        yaw = blocks[:, 2:] - np.arctan2(HEADINGS[:, 1], HEADINGS[:, 0])  # (n, headings)
        turned = np.abs((yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        place = (blocks[:, :2] - [self._axes[0][0], self._axes[1][0]]) / CELL
        heading = np.broadcast_to(np.arange(len(HEADINGS)), turned.shape)
        place = [np.broadcast_to(column[:, None], turned.shape) for column in place.T]
        left = map_coordinates(self._left, [*place, heading], order=1, mode="nearest")
        return (left + TURNED * np.maximum(0, turned - FACING) ** 2).min(1)

    @cached_property
    def _axes(self) -> tuple[Float[np.ndarray, " nx"], Float[np.ndarray, " ny"]]:
        x, y = (np.arange(axis[0] - BORDER, axis[-1] + BORDER, CELL) for axis in (self.table.x, self.table.y))
        return x, y

    @cached_property
    def _left(self) -> Float[np.ndarray, "nx ny headings"]:
        """By Dijkstra's method, backwards from the target over cells and directions."""
        points = np.stack(np.meshgrid(*self._axes, indexing="ij"), -1)
        length = np.linalg.norm(HEADINGS, axis=1)
        pushers = points[:, :, None] - BEHIND * HEADINGS / length[:, None]  # (nx, ny, headings, 2)
        can = self.table.allows(pushers)
        price = 1 + NARROW * np.clip(1 - self.table.clearance(pushers) / ROOMY, 0, 1)
        headings, cell = len(HEADINGS), np.arange(can[..., 0].size).reshape(can.shape[:2])
        goal = can.size
        edges = [_to_goal(cell[np.linalg.norm(points - self.target, axis=-1) < PLACED], headings, goal)]
        for k, step in enumerate(HEADINGS):
            start, end = _shifted(cell, step)
            edges.append(
                (start * headings + k, end * headings + k, CELL * length[k] * price.ravel()[start * headings + k])
            )
            for other in set(range(headings)) - {k}:
                near = HEADINGS[k] @ HEADINGS[other] > 0.85 * length[k] * length[other]
                cost = np.full(cell.shape, TURN if near else REGRIP)
                edges.append((cell * headings + k, cell * headings + other, cost))
        start, end, cost = (np.concatenate([part.ravel() for part in parts]) for parts in zip(*edges, strict=True))
        allowed = np.append(can.ravel(), True)
        kept = allowed[start] & allowed[end]
        graph = coo_matrix((cost[kept], (end[kept], start[kept])), shape=(goal + 1, goal + 1)).tocsr()
        left = dijkstra(graph, indices=goal)[:-1].reshape(can.shape)
        none = ~np.isfinite(left).any(-1)
        away = distance_transform_edt(none) if not none.all() else np.ones(none.shape)
        return np.where(np.isfinite(left), left, LOST + LOST_SLOPE * CELL * away[..., None])


def _to_goal(
    cells: Int[np.ndarray, " n"], headings: int, goal: int
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """From these cells, whatever the direction, the goal is reached at next to no cost (none would be no edge)."""
    start = (cells[:, None] * headings + np.arange(headings)).ravel()
    return start, np.full(len(start), goal), np.full(len(start), 1e-9)


def _shifted(
    cell: Int[np.ndarray, "nx ny"], step: Int[np.ndarray, "2"]
) -> tuple[Int[np.ndarray, "mx my"], Int[np.ndarray, "mx my"]]:
    """Cells whose neighbour by `step` is on the grid, and that neighbour."""
    low, high = np.maximum(-step, 0), np.array(cell.shape) - np.maximum(step, 0)
    start = cell[low[0] : high[0], low[1] : high[1]]
    return start, start + step[0] * cell.shape[1] + step[1]
