import numpy as np
import pytest

from richmap.geometry.directions import bin_of, bins_per_edge, capacity_bound, neighbour_bins


def random_directions(n, seed=0):
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_the_bound_is_the_papers_figure():
    assert capacity_bound(0.1) == pytest.approx(1600, abs=1)


@pytest.mark.parametrize("theta", [0.1, 0.3])
def test_two_directions_in_a_bin_are_closer_than_theta(theta):
    n = bins_per_edge(theta)
    v = random_directions(20_000)
    bins = np.array([bin_of(*row, n) for row in v])
    for b in np.unique(bins)[:300]:
        assert (v[bins == b] @ v[bins == b].T).min() > np.cos(theta)


@pytest.mark.parametrize("theta", [0.1, 0.3])
def test_whatever_is_closer_than_theta_is_in_the_bin_or_a_neighbour(theta):
    n = bins_per_edge(theta)
    offsets, lists = neighbour_bins(theta)
    v = random_directions(3000, seed=1)
    bins = np.array([bin_of(*row, n) for row in v])
    assert bins.min() >= 0 and bins.max() < len(offsets) - 1
    near = (v @ v.T) > np.cos(theta)
    for i in range(0, len(v), 5):
        reach = {bins[i], *lists[offsets[bins[i]] : offsets[bins[i] + 1]]}
        assert set(bins[near[i]]) <= reach
