import numpy as np
import pytest

from richmap.geometry.grid import Grid
from richmap.maps.coverage import CoverageBitmap
from richmap.maps.direction_index import DirectionIndex
from richmap.outputs import FileRefusedError

THETA = 0.1
GRID = Grid((-0.1, -0.1, -0.1), 0.1, (2, 2, 2))


def unit_vectors(n, rng):
    vectors = rng.normal(size=(n, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def stored():
    """Cells that are full, half empty, sparse, of one direction, and empty."""
    rng = np.random.default_rng(0)
    cells = [unit_vectors(n, rng) for n in (600, 1200, 12, 1, 0, 600, 40, 0)]
    cells[1] = cells[1][cells[1][:, 2] > 0.3]
    return np.concatenate([[0], np.cumsum([len(cell) for cell in cells])]), np.concatenate(cells)


@pytest.fixture(scope="module")
def bitmap(stored):
    return CoverageBitmap.build(GRID, *stored, THETA)


def random_poses(n, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.13, 0.13, (n, 3)), unit_vectors(n, rng)  # some outside the grid


def poses_on_the_edge(stored, seed):
    """Poses theta from a stored direction, to within rounding."""
    rng = np.random.default_rng(seed)
    start, directions = stored
    row = rng.integers(len(directions), size=20_000)
    cell = np.searchsorted(start, row, side="right") - 1
    v = directions[row].astype(float)
    aside = np.cross(v, unit_vectors(len(v), rng))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    angle = THETA + rng.uniform(-1e-6, 1e-6, (len(v), 1))
    return GRID.centres()[cell], (np.cos(angle) * v + np.sin(angle) * aside).astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_exact_answers_are_those_of_the_stored_directions(stored, bitmap, seed):
    index = DirectionIndex.build(GRID, *stored)
    for poses in (random_poses(100_000, seed), poses_on_the_edge(stored, seed)):
        expected = index.within(*poses, THETA)
        assert (bitmap.reachable_exactly(*poses, index) == expected).all()
        assert 0.1 < expected.mean() < 0.9


def test_bits_differ_from_exact_answers_in_open_bins_only_and_seldom(stored, bitmap):
    index = DirectionIndex.build(GRID, *stored)
    position, direction = random_poses(200_000, 5)
    wrong = bitmap.reachable(position, direction) != index.within(position, direction, THETA)
    assert 0 < wrong.mean() < 0.01
    is_open = CoverageBitmap(GRID, THETA, bitmap.bins_per_edge, bitmap.slot, bitmap.open, bitmap.covered)
    assert is_open.reachable(position[wrong], direction[wrong]).all()


def test_finer_bins_are_more_often_right(stored):
    index = DirectionIndex.build(GRID, *stored)
    poses = random_poses(100_000, 6)
    expected = index.within(*poses, THETA)
    wrong = [
        (CoverageBitmap.build(GRID, *stored, THETA, bins).reachable(*poses) != expected).mean() for bins in (16, 32, 64)
    ]
    assert wrong[0] > 1.5 * wrong[1] > 1.5**2 * wrong[2]


def test_one_direction_covers_the_bins_of_its_cap(stored):
    v = unit_vectors(1, np.random.default_rng(1))
    bitmap = CoverageBitmap.build(GRID, np.array([0, 1] + [1] * 7), v, 0.3)
    share = np.unpackbits(bitmap.covered).mean()
    assert share == pytest.approx((1 - np.cos(0.3)) / 2, rel=0.15)  # bins are not quite of one size


def test_outside_the_grid_nothing_is_reachable(stored, bitmap):
    positions = np.array([[0.3, 0, 0], [np.nan, 0, 0], [0, 0, -1e300], [0.05, 0.05, 0.05]])  # the last: an empty cell
    directions = np.repeat(stored[1][:1], 4, axis=0)
    assert not bitmap.reachable(positions, directions).any()
    assert not bitmap.reachable_exactly(positions, directions, DirectionIndex.build(GRID, *stored)).any()


def test_the_index_of_another_map_is_refused(stored, bitmap):
    start, directions = stored
    for grid, first in ((Grid((0.0, 0.0, 0.0), 0.1, (2, 2, 2)), start), (GRID, np.minimum(start, start[-3]))):
        with pytest.raises(ValueError, match="of another map"):
            bitmap.reachable_exactly(*random_poses(10, 0), DirectionIndex.build(grid, first, directions))


def test_an_odd_number_of_bins_is_refused(stored):
    with pytest.raises(ValueError, match="multiple of 8"):
        CoverageBitmap.build(GRID, *stored, THETA, 50)


def test_a_bitmap_survives_the_file_and_broken_files_are_refused(bitmap, tmp_path):
    file = tmp_path / "coverage.safetensors"
    bitmap.save(file)
    again = CoverageBitmap.load(file)
    assert (again.grid, again.theta, again.bins_per_edge) == (GRID, THETA, bitmap.bins_per_edge)
    assert all((getattr(again, name) == getattr(bitmap, name)).all() for name in ("slot", "covered", "open"))
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(FileRefusedError, match="cut short"):
        CoverageBitmap.load(file)
