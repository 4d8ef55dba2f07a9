"""The field of a UR3 against the xArm6, from real maps, as far as they are full after some seconds."""

import numpy as np
import pytest

from richmap.geometry.grid import Grid
from richmap.maps.construction import build_map
from richmap.maps.reachability_map import Construction
from richmap.robots.robots import load_robot
from richmap.similarity.energy import EnergyField, EnergySettings
from richmap.similarity.similarity import compare_maps
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

pytestmark = pytest.mark.system


RADIAL_SLOPE = {
    0.05: -0.100, 0.10: -0.063, 0.15: -0.019, 0.20: -0.003, 0.25: -0.000, 0.30: 0.001, 0.35: 0.012,
    0.40: 0.050, 0.45: 0.121, 0.50: 0.189, 0.55: 0.219, 0.60: 0.234, 0.70: 0.241,
}  # fmt: skip
"""dE/dR in [1/m], mean over R to R + .05 m, of an independent implementation with convex hulls."""


@pytest.fixture
def field(tmp_path):
    """Of one test, so that one worker makes the maps. Directions are farther apart than the paper's: as many do."""
    grid, built = Grid.around_base(cell_size=0.05, half_width=1.0, z_offset=0.2), {}
    for name in ("xarm6", "ur3"):
        robot = load_robot(name)
        settings = Construction(name, robot.fingerprint, 0.2, seed=0, draw=2048, turns=64, stop_rate=0.05, target=0)
        built[name] = build_map(robot, grid, settings, tmp_path / name, workers=1)
    return EnergyField.from_similarity(compare_maps(built["xarm6"], built["ur3"]), EnergySettings(), {})


def ring(radius):
    """Points all around the base at the flange's height, and the outward direction at each."""
    angle, r = np.meshgrid(np.linspace(-np.pi, np.pi, 360, endpoint=False), radius + np.linspace(0, 0.05, 11)[:-1])
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1).reshape(-1, 3)
    return BLOCK_PUSH_SPACE.steps.positions(outward[:, :2] * r.reshape(-1, 1)), outward


def test_its_slope_is_radial_and_that_of_an_independent_implementation(field):
    """Radial because the arms turn about the vertical."""
    for radius, expected in RADIAL_SLOPE.items():
        points, outward = ring(radius)
        _, gradient = field.value_and_gradient(points)
        radial = (gradient * outward).sum(1)
        assert abs(radial.mean() - expected) < min(0.035, 0.015 + 0.25 * abs(expected)), radius
        if radius == 0.5:
            assert np.abs(np.cross(outward, gradient)[:, 2]).mean() < 0.1 * np.abs(radial).mean()
