"""The pusher's way over the table: around blocks, and only where the arm can be."""

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from envs.arm.feasibility import TableFeasibility

KEEP_OFF = 0.036
"""Distance that the pusher keeps from blocks' centres, in [m]: half a diagonal, its own radius, and 3 mm."""
CELL = 0.01
"""Of the grid on which a way is sought, in [m]."""
TOUCHING, NOT_ALLOWED = 50.0, 200.0
"""How many times its length a way costs too near to a block, and where the arm cannot be; so that there always is one
out of there."""


def is_free(
    table: TableFeasibility,
    start: Float[np.ndarray, "2"],
    end: Float[np.ndarray, "2"],
    blocks: Float[np.ndarray, "k 2"],
) -> bool:
    """Whether the straight way keeps off the blocks, in [m], and the arm can follow it.

    A way that starts too near to a block is free if it leads away from it.
    """
    steps = 1 + int(np.ceil(np.linalg.norm(end - start) / 0.005))
    way = start + np.linspace(0, 1, steps + 1)[:, None] * (end - start)
    distance = np.linalg.norm(way[:, None] - blocks, axis=-1)  # (steps, k)
    kept = np.minimum(KEEP_OFF, distance[0]) - 1e-3
    return bool((distance >= kept).all() and table.allows(way[1:]).all())


def next_point(
    table: TableFeasibility,
    start: Float[np.ndarray, "2"],
    end: Float[np.ndarray, "2"],
    blocks: Float[np.ndarray, "k 2"],
) -> Float[np.ndarray, "2"]:
    """Where to head for now, in [m], so as to get from start to end: as far along the way as is free."""
    if is_free(table, start, end, blocks):
        return end
    way = _way(table, start, end, blocks)
    for point in way[::-1]:
        if is_free(table, start, point, blocks):
            return point
    return way[min(2, len(way) - 1)]


def _way(
    table: TableFeasibility,
    start: Float[np.ndarray, "2"],
    end: Float[np.ndarray, "2"],
    blocks: Float[np.ndarray, "k 2"],
) -> Float[np.ndarray, "n 2"]:
    """Points a cell apart, from start to end, by Dijkstra's method."""
    x, y = (np.arange(axis[0], axis[-1] + CELL / 2, CELL) for axis in (table.x, table.y))
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    inside = np.maximum(0, KEEP_OFF - np.linalg.norm(points[:, :, None] - blocks, axis=-1).min(-1))
    price = 1 + TOUCHING * (inside > 0) * (1 + inside / KEEP_OFF) + NOT_ALLOWED * ~table.allows(points)
    cell = np.arange(price.size).reshape(price.shape)
    edges = []
    for a, b, length in (
        (cell[:-1], cell[1:], 1.0),
        (cell[:, :-1], cell[:, 1:], 1.0),
        (cell[:-1, :-1], cell[1:, 1:], 2**0.5),
        (cell[:-1, 1:], cell[1:, :-1], 2**0.5),
    ):
        edges.append((a.ravel(), b.ravel(), length * (price.flat[a.ravel()] + price.flat[b.ravel()])))
    a, b, cost = (np.concatenate(parts) for parts in zip(*edges, strict=True))
    graph = coo_matrix((cost, (a, b)), shape=(cell.size, cell.size)).tocsr()
    first, last = (np.linalg.norm(points - point, axis=-1).argmin() for point in (start, end))
    before = dijkstra(graph, directed=False, indices=last, return_predecessors=True)[1]
    way = []
    while first != last:
        first = before[first]
        way.append(points.reshape(-1, 2)[first])
    return np.array([*way[:-1], end])
