"""Where an arm can hold its tool upright by its map alone, as a signed distance."""

import numpy as np
import pytest

from envs.block_push.holding import mapped_distance
from envs.block_push.workspace import HEIGHT
from richmap.geometry.grid import Grid
from richmap.similarity.directional import DirectionalCoverage

BASE = (0.1, 0.05, 0.0)
GRID = Grid.around_base(0.05, 1.0, 0.2).moved(-np.array(BASE))


def covered_within(least, most):
    """A made-up arm that takes the tool from every direction, at these distances from its base axis."""
    x, y, _ = (GRID.centres() - BASE).T
    radius = np.hypot(x, y)
    inside = ((least < radius) & (radius < most)).reshape(*GRID.shape, 1)
    one = DirectionalCoverage(GRID, np.ones((*GRID.shape, 1), np.float32), {"target": "disc"})
    everywhere = one.value_and_gradients(np.array([[0.3, 0.0, HEIGHT]]), np.array([[0.0, 0.0, -1.0]])).value[0]
    return DirectionalCoverage(GRID, (inside / everywhere).astype(np.float32), {"target": "disc"})


def test_it_is_the_distance_to_the_border_of_what_is_covered():
    field = mapped_distance(covered_within(0.2, 0.5), BASE)
    angle, radius = np.meshgrid(np.linspace(-0.9, 0.9, 19), [0.1, 0.25, 0.35, 0.45, 0.6])
    x, y = BASE[0] + radius * np.cos(angle), BASE[1] + radius * np.sin(angle)
    found, _ = field.value_and_gradient(np.stack([x, y, np.full_like(x, HEIGHT)], -1).reshape(-1, 3))
    expected = np.maximum(0.2 - radius, radius - 0.5).ravel()
    assert np.abs(found - expected).max() < 0.04  # Cells of 0.05 m, and then of 0.02 m.
    assert abs(found - expected).mean() < 0.015
    assert field.inner == pytest.approx(0.2, abs=0.03) and field.outer == pytest.approx(0.5, abs=0.03)
    assert field.about["target"] == "disc"


def test_an_arm_whose_map_has_the_direction_nowhere_is_refused():
    with pytest.raises(ValueError, match="nowhere over the table"):
        mapped_distance(covered_within(3.0, 4.0), BASE)
