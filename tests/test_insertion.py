import numpy as np
import pytest

from richmap.directions import capacity_bound
from richmap.grid import Grid
from richmap.insertion import Inserter
from richmap.sampling import WorkspaceSamples

THETA = 0.3
GRID = Grid((-0.1, -0.1, -0.1), 0.1, (2, 2, 2))


def random_samples(n, seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = rng.uniform(-0.13, 0.13, (n, 3))  # some outside the grid
    joints = np.arange(n, dtype=np.float32)[:, None] + n * seed
    return WorkspaceSamples(joints, position.astype(np.float32), direction.astype(np.float32), n)


def insert_slowly(batches):
    """Pose after pose, against everything in its cell."""
    kept = {}
    for batch in batches:
        for joints, position, direction in zip(batch.joints, batch.position, batch.direction, strict=True):
            cell = GRID.cells_of(position[None])[0]
            if cell < 0:
                continue
            others = kept.setdefault(cell, [])
            if all(np.dot(direction, other) <= np.cos(THETA) for other, _ in others):
                others.append((direction, joints[0]))
    return kept


@pytest.fixture(scope="module")
def batches():
    return [random_samples(2000, seed) for seed in range(3)]


@pytest.fixture(scope="module")
def inserter(batches):
    inserter = Inserter(GRID, THETA, dof=1)
    for batch in batches:
        inserter.insert(batch)
    return inserter


def test_inserts_what_pose_after_pose_would(inserter, batches):
    cell, direction, joints = inserter.stored()
    for c, expected in insert_slowly(batches).items():
        assert (direction[cell == c] == np.array([d for d, _ in expected])).all()
        assert (joints[cell == c, 0] == [j for _, j in expected]).all()
    assert inserter.inserted == len(cell)
    assert inserter.filled_cells == len(np.unique(cell)) == 8


def test_directions_in_a_cell_are_theta_apart_and_within_capacity(inserter):
    cell, direction, _ = inserter.stored()
    for c in range(8):
        v = direction[cell == c].astype(float)
        angle = np.arccos(np.clip(v @ v.T, -1, 1))
        np.fill_diagonal(angle, np.pi)
        assert angle.min() >= THETA - 1e-5
        assert len(v) <= capacity_bound(THETA)


def test_a_batch_given_twice_brings_nothing(inserter, batches):
    before = inserter.inserted
    assert not inserter.insert(batches[0]).any()
    assert inserter.inserted == before
