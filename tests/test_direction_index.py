import numpy as np
import pytest

from richmap.geometry.direction_blocks import block_of
from richmap.geometry.grid import Grid
from richmap.maps.direction_index import DirectionIndex

GRID = Grid((-0.1, -0.1, -0.1), 0.1, (2, 2, 2))


def unit_vectors(n, rng):
    vectors = rng.normal(size=(n, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def random_map(seed=0):
    """Cells that are full, half empty (one cap of directions), sparse, of one direction, and empty."""
    rng = np.random.default_rng(seed)
    cells = [unit_vectors(n, rng) for n in (900, 2000, 12, 1, 0, 900, 40, 3)]
    cells[1] = cells[1][cells[1][:, 2] > 0.3]
    start = np.concatenate([[0], np.cumsum([len(cell) for cell in cells])])
    return start, np.concatenate(cells)


def random_poses(n, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.13, 0.13, (n, 3)), unit_vectors(n, rng)  # some outside the grid


def cosines(vectors, v):
    """In float32, one product after the other, as the index and the inserter compute them."""
    return vectors[:, 0] * v[0] + vectors[:, 1] * v[1] + vectors[:, 2] * v[2]


def scan(start, directions, position, direction):
    rows, best = [], []
    for c, v in zip(GRID.cells_of(position), direction, strict=True):
        cell = slice(start[c], start[c + 1]) if c >= 0 else slice(0, 0)
        of_cell = cosines(directions[cell], v)
        rows.append(cell.start + np.argmax(of_cell) if len(of_cell) else -1)
        best.append(of_cell.max() if len(of_cell) else -2)
    return np.array(rows), np.array(best, dtype=np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_finds_what_a_scan_of_the_cell_finds_bit_for_bit(seed):
    start, directions = random_map(seed)
    poses = random_poses(5000, seed + 10)
    row, cosine = DirectionIndex.build(GRID, start, directions).nearest(*poses)
    expected_row, expected_cosine = scan(start, directions, *poses)
    assert (row == expected_row).all()
    assert (cosine == expected_cosine).all()


def test_of_equally_near_directions_it_names_the_first():
    signs = np.array([[a, b, c] for a in (1, -1) for b in (1, -1) for c in (1, -1)], dtype=np.float32)
    rng = np.random.default_rng(0)
    directions = np.concatenate([signs[rng.permutation(8)], np.eye(3, dtype=np.float32), -np.eye(3, dtype=np.float32)])
    directions = directions / np.sqrt((directions**2).sum(1, keepdims=True))
    start = np.concatenate([[0], np.full(8, len(directions))])
    queries = np.concatenate([directions, *(signs * scale for scale in np.eye(3, dtype=np.float32))])
    poses = np.full((len(queries), 3), -0.05), queries  # all in the first cell
    row, _ = DirectionIndex.build(GRID, start, directions).nearest(*poses)
    assert (row == scan(start, directions, *poses)[0]).all()


@pytest.mark.system
def test_within_is_a_float32_comparison_with_the_angles_cosine():
    start, directions = random_map()
    index = DirectionIndex.build(GRID, start, directions)
    poses = random_poses(5000, 1)
    _, best = scan(start, directions, *poses)
    own = np.arccos(best[best > -2][:5].astype(float))  # a direction's own cosine
    for angle in (0.02, 0.1, 0.4, 1.5, *own):
        assert (index.within(*poses, angle) == (best > np.float32(np.cos(angle)))).all()


def test_many_queries_are_answered_as_few_are():
    start, directions = random_map()
    index = DirectionIndex.build(GRID, start, directions)
    position, direction = random_poses(300_000, 2)
    row, cosine = index.nearest(position, direction)
    some = slice(None, None, 1000)
    expected = index.nearest(position[some], direction[some])
    assert (row[some] == expected[0]).all() and (cosine[some] == expected[1]).all()


def test_sorted_directions_are_not_copied():
    start, directions = random_map()
    cell = np.repeat(np.arange(8), np.diff(start))
    directions = directions[np.lexsort([block_of(directions), cell])]
    index = DirectionIndex.build(GRID, start, directions)
    assert np.shares_memory(index.directions, directions)
    poses = random_poses(1000, 3)
    assert (index.nearest(*poses)[0] == scan(start, directions, *poses)[0]).all()


def test_points_that_are_no_numbers_are_outside():
    start, directions = random_map()
    positions = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, -1e300, 0]])
    index = DirectionIndex.build(GRID, start, directions)
    assert (index.nearest(positions, directions[:3])[0] == -1).all()
    assert not index.within(positions, directions[:3], 0.5).any()
