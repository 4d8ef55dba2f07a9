from unittest.mock import Mock

import numpy as np
import pytest

from richmap.geometry.grid import Grid
from richmap.maps.compression import coverage_fraction, fibonacci_lattice
from richmap.maps.reachability_map import ReachabilityMap

THETA = 0.3


def map_of(*cells):
    """As much of a map as its compression looks at: a row of cells with these directions each."""
    grid, start = Grid((0.0, 0.0, 0.0), 0.1, (1, len(cells), 1)), np.cumsum([0, *map(len, cells)])
    directions = np.concatenate(cells).astype(np.float32)
    return Mock(ReachabilityMap, grid=grid, start=start, directions=directions, construction=Mock(theta=THETA))


def random_directions(n, seed):
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


POLES = np.concatenate([np.eye(3), -np.eye(3)])
EMPTY = np.empty((0, 3))


def test_a_full_sphere_is_covered_and_an_empty_cell_is_not():
    fractions = coverage_fraction(map_of(random_directions(2000, 0), EMPTY, fibonacci_lattice(500)), 1000)
    assert fractions.shape == (1, 3, 1)
    assert fractions.ravel().tolist() == [1, 0, 1]


@pytest.mark.parametrize("direction", [*POLES, *random_directions(5, 1)])
def test_one_direction_covers_its_cap(direction):
    share = coverage_fraction(map_of(direction[None]), 20_000).item()
    assert share == pytest.approx((1 - np.cos(THETA)) / 2, rel=0.02)


def test_directions_that_are_far_apart_cover_their_caps_together():
    share = coverage_fraction(map_of(POLES), 20_000).item()
    assert share == pytest.approx(3 * (1 - np.cos(THETA)), rel=0.005)


def test_agrees_with_the_definition():
    cells = [random_directions(n, n) for n in (1, 3, 10, 30, 100, 300)] + [POLES]
    lattice = fibonacci_lattice(777)
    expected = [(np.arccos(lattice @ v.T).min(1) < THETA).mean() for v in cells]
    assert coverage_fraction(map_of(*cells), 777).ravel() == pytest.approx(expected, abs=1e-6)


def test_the_lattice_is_even():
    lattice = fibonacci_lattice(5000)
    assert np.allclose(np.linalg.norm(lattice, axis=1), 1)
    assert np.abs(lattice.mean(0)).max() < 1e-3
    assert np.allclose(lattice.T @ lattice / 5000, np.eye(3) / 3, atol=1e-3)
