import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from richmap.geometry.grid import Grid, GridMismatchError
from richmap.maps.reachability_map import Construction, ReachabilityMap
from richmap.similarity.similarity import compare_maps, direction_moments, kernel, mmd_squared

GRID = Grid((0.0, 0.0, 0.0), 0.5, (2, 2, 2))


def directions(n, seed, spread=1.0):
    v = np.random.default_rng(seed).normal(size=(n, 3)) * [1, 1, spread] + [0, 0, 0.5]
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def a_map(sets, grid=GRID):
    cell = np.repeat(list(sets), [len(v) for v in sets.values()])
    rows = np.concatenate(list(sets.values())).astype(np.float32)
    about = Construction("robot", "", 0.1, 0, 1, 1, 0.1, 0)
    return ReachabilityMap.from_rows(
        grid, cell, rows, np.zeros((len(rows), 6)), np.array([[-1.0] * 6, [1.0] * 6]), about
    )


def mmd_squared_slow(x, y, scales):
    """The definition, pair after pair."""

    def k(u, v):
        gammas = [2 ** (m - scales / 2) for m in range(1, scales + 1)]
        return sum(np.exp(-gamma * np.sum((u - v) ** 2)) for gamma in gammas) / scales

    def mean(a, b):
        return np.mean([[k(u, v) for v in b] for u in a])

    return mean(x, x) - 2 * mean(x, y) + mean(y, y)


@pytest.mark.parametrize("scales", [1, 5])
def test_the_sum_over_pairs_is_the_definition(scales):
    x, y = directions(12, 0), directions(17, 1)
    assert mmd_squared(x, y, scales) == pytest.approx(mmd_squared_slow(x, y, scales), rel=1e-12)


@pytest.mark.parametrize(("scales", "error"), [(3, 1e-4), (5, 1e-4), (7, 1e-2)])
def test_harmonics_give_the_sum_over_pairs(scales, error):
    sets = {c: directions(20 + 60 * c, c, spread=1 + c) for c in range(6)}
    others = {c: directions(300 - 40 * c, 10 + c) for c in range(6)}
    fast = compare_maps(a_map(sets), a_map(others), scales=scales).mmd
    for c in range(6):
        assert fast[c] ** 2 == pytest.approx(mmd_squared(sets[c], others[c], scales), rel=error)


def test_moments_stand_for_their_map():
    a, b = a_map({0: directions(50, 0), 1: directions(9, 1)}), a_map({0: directions(40, 2), 2: directions(9, 3)})
    by_moments = compare_maps(direction_moments(a), direction_moments(b))
    assert np.array_equal(by_moments.mmd, compare_maps(a, b).mmd, equal_nan=True)


def test_a_map_equals_itself_and_similarity_is_symmetric():
    a, b = (
        a_map({0: directions(50, 0), 1: directions(9, 1)}),
        a_map({0: directions(40, 2), 2: directions(9, 3)}),
    )
    assert (compare_maps(a, a).mmd[:2] == 0).all()
    assert compare_maps(a, b).mmd[0] == compare_maps(b, a).mmd[0] > 0


def test_turning_both_robots_together_changes_nothing():
    x, y = directions(80, 0), directions(60, 1)
    turn = Rotation.random(rng=0).as_matrix()
    before = compare_maps(a_map({3: x}), a_map({3: y})).mmd[3]
    after = compare_maps(a_map({3: x @ turn.T}), a_map({3: y @ turn.T})).mmd[3]
    assert after == pytest.approx(before, rel=1e-4)


def test_cells_that_one_robot_or_none_fills_are_masks_not_numbers():
    alone = directions(5, 0)
    grid = compare_maps(a_map({0: alone, 1: directions(5, 1)}), a_map({1: directions(5, 2), 2: directions(5, 3)}))
    assert np.flatnonzero(~np.isnan(grid.mmd)).tolist() == [1]
    assert np.flatnonzero(grid.only_source).tolist() == [0]
    assert np.flatnonzero(grid.only_target).tolist() == [2]
    assert np.flatnonzero(~np.isnan(grid.one_sided)).tolist() == [0, 2]
    assert grid.one_sided[0] ** 2 == pytest.approx(kernel(alone @ alone.T).mean(), rel=1e-4)


def test_the_kernel_is_one_for_equal_directions_and_falls_with_the_angle():
    angle = np.linspace(0, np.pi, 50)
    assert kernel(np.array([1.0])) == 1
    assert (np.diff(kernel(np.cos(angle))) < 0).all()


def test_cells_must_coincide_in_the_world():
    a = a_map({0: directions(5, 0)})
    moved = a_map({0: directions(5, 0)}, GRID.moved(np.array([0.2, 0, 0])))
    assert compare_maps(a, moved, base=(0.2, 0.0, 0.0)).mmd[0] == 0
    with pytest.raises(GridMismatchError, match="base at"):
        compare_maps(a, moved)


def test_an_empty_set_has_no_discrepancy():
    with pytest.raises(ValueError, match="both sides. Got 0 and 5"):
        mmd_squared(np.empty((0, 3)), directions(5, 0))
