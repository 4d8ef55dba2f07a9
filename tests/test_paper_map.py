import numpy as np
import pytest

from richmap.counterparts.paper_map import TorchInserter, TorchNearest
from richmap.geometry.grid import Grid

THETA = 0.3
GRID = Grid((-0.1, -0.1, -0.1), 0.1, (2, 2, 2))
COSINE = np.float32(np.cos(THETA))


def random_poses(n, seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = rng.uniform(-0.13, 0.13, (n, 3))  # some outside the grid
    joints = np.arange(n)[:, None] + n * seed
    return [array.astype(np.float32) for array in (position, direction, joints)]


def insert_slowly(batches):
    """Pose after pose, against everything in its cell; the configurations that stay."""
    kept, order = {}, []
    for position, direction, joints in batches:
        for c, v, q in zip(GRID.cells_of(position), direction, joints, strict=True):
            others = kept.setdefault(c, [])
            if c >= 0 and all(np.dot(v, other) <= COSINE for other in others):
                others.append(v)
                order.append(q[0])
    return order


def inserted(batches):
    inserter = TorchInserter(GRID, THETA, dof=1, device="cpu")
    masks = [inserter.insert(*batch) for batch in batches]
    return inserter, masks


def test_inserts_what_pose_after_pose_would():
    batches = [random_poses(n, seed) for seed, n in enumerate([2000, 1, 500, 0, 2000])]
    inserter, masks = inserted(batches)
    cell, direction, joints = inserter.stored()
    expected = insert_slowly(batches)
    assert joints[:, 0].tolist() == expected
    assert inserter.inserted == len(expected) == sum(mask.sum() for mask in masks)
    assert inserter.filled_cells == len(np.unique(cell)) == 8
    for (position, directions, _), mask in zip(batches, masks, strict=True):
        assert (GRID.cells_of(position[mask]) >= 0).all()
        assert np.isin(directions[mask], direction).all()


def test_how_poses_are_grouped_into_products_does_not_matter(monkeypatch):
    batches = [random_poses(1000, seed) for seed in range(2)]
    whole = inserted(batches)[0].stored()
    monkeypatch.setattr("richmap.maps.torch_insertion.PRODUCTS", {"cpu": 5000})
    pieces = inserted(batches)[0].stored()
    assert all((a == b).all() for a, b in zip(whole, pieces, strict=True))


def test_a_batch_given_twice_brings_nothing():
    batch = random_poses(1000, 0)
    assert not inserted([batch, batch])[1][1].any()


def test_a_build_goes_on_from_what_was_stored():
    batches = [random_poses(1000, seed) for seed in range(2)]
    whole = inserted(batches)[0].stored()
    inserter = TorchInserter(GRID, THETA, dof=1, device="cpu")
    inserter.resume(*inserted(batches[:1])[0].stored())
    inserter.insert(*batches[1])
    assert all((a == b).all() for a, b in zip(whole, inserter.stored(), strict=True))


def test_nearest_is_what_a_scan_of_the_map_finds():
    cell, stored, _ = inserted([random_poses(1000, seed) for seed in range(2)])[0].stored()
    order = np.argsort(cell, kind="stable")
    order = order[cell[order] != 3]  # one cell is empty
    stored, start = stored[order], np.searchsorted(cell[order], np.arange(GRID.n_cells + 1))
    position, direction, _ = random_poses(3000, 7)
    row, cosine = TorchNearest(GRID, start, stored, "cpu")(position, direction)
    for c, v, r, found in zip(GRID.cells_of(position), direction, row, cosine, strict=True):
        if c in (-1, 3):
            assert (r, found) == (-1, -2)
        else:
            assert start[c] <= r < start[c + 1]
            assert found == pytest.approx((stored[start[c] : start[c + 1]] @ v).max(), abs=1e-6)
            assert stored[r] @ v == pytest.approx(found, abs=1e-6)


def test_a_separation_beyond_a_right_angle_is_refused():
    with pytest.raises(ValueError, match="2.0 rad"):
        TorchInserter(GRID, 2.0, dof=1, device="cpu")
