from itertools import groupby

import numpy as np
import pytest

from richmap.geometry.grid import Grid
from richmap.maps.pose_queries import filter_grasps, nearest_poses, reach_along_path
from richmap.motion.kinematics import flange_frames
from richmap.robots.robots import load_robot

ROBOT = load_robot("xarm6")
GRID = Grid.around_base(cell_size=0.2, half_width=0.8, z_offset=0.2)


@pytest.fixture(scope="module")
def coarse_map(sampled_map):
    return sampled_map("xarm6", GRID, 30_000)


def random_poses(n, half_width=0.7):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(n, 3))
    return rng.uniform(-half_width, half_width, (n, 3)), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_grasps_that_stay_are_those_that_the_map_reaches(coarse_map):
    positions, directions = random_poses(200)
    keep, seeds = filter_grasps(coarse_map, positions, directions)
    assert np.array_equal(keep, coarse_map.reachable(positions, directions))
    assert 0 < keep.sum() == len(seeds) < 200


def test_a_seed_reaches_the_grasp_s_cell_and_nearly_its_direction(coarse_map):
    positions, directions = random_poses(200)
    keep, seeds = filter_grasps(coarse_map, positions, directions)
    reached, rotation = flange_frames(ROBOT, seeds)
    assert (GRID.cells_of(reached) == GRID.cells_of(positions[keep])).mean() > 0.98  # but for rounding at a face
    cosine = (rotation[:, :, 2] * directions[keep]).sum(1)
    assert (np.arccos(cosine) < coarse_map.construction.theta + 1e-3).all()


def test_the_stretch_of_a_path_is_the_longest_without_a_gap(coarse_map):
    tool_down = np.tile([0.0, 0.0, -1.0], (60, 1))
    for y in np.linspace(-0.7, 0.7, 8):
        positions = np.linspace([-0.95, y, 0.3], [0.95, y, 0.3], 60)
        path = reach_along_path(coarse_map, positions, tool_down)
        expected, at = (0, 0), 0
        for reachable, run in groupby(coarse_map.reachable(positions, tool_down)):
            length = len(list(run))
            if reachable and length > expected[1] - expected[0]:
                expected = (at, at + length)
            at += length
        assert (path.start, path.stop) == expected


def test_a_path_out_of_reach_has_an_empty_stretch(coarse_map):
    path = reach_along_path(coarse_map, *random_poses(5, half_width=0.1) + np.array([[[5.0]], [[0.0]]]))
    assert not path.reachable.any() and path.start == path.stop


def all_poses(robot_map):
    """Every cell centre with every direction stored there."""
    return np.repeat(robot_map.grid.centres(), np.diff(robot_map.start), axis=0), robot_map.directions.astype(float)


@pytest.mark.parametrize("metres_per_radian", [0.02, 0.1, 1.0])
def test_nearest_poses_agree_with_a_search_through_everything(coarse_map, metres_per_radian):
    positions, directions = random_poses(60, half_width=1.5)  # Within the grid and beyond.
    nearest = nearest_poses(coarse_map, positions, directions, metres_per_radian)
    centres, stored = all_poses(coarse_map)
    for i in range(60):
        distance = np.linalg.norm(centres - positions[i], axis=1)
        angle = 2 * np.arcsin(np.minimum(np.linalg.norm(stored - directions[i], axis=1) / 2, 1))
        least = (distance + metres_per_radian * angle).min()
        assert nearest.distance[i] + metres_per_radian * nearest.angle[i] == pytest.approx(least, abs=1e-9)
        assert distance[nearest.row[i]] == pytest.approx(nearest.distance[i], abs=1e-9)
        assert angle[nearest.row[i]] == pytest.approx(nearest.angle[i], abs=1e-9)
    assert nearest.positions == pytest.approx(centres[nearest.row])
    assert nearest.directions == pytest.approx(stored[nearest.row])


def test_a_pose_of_the_map_is_its_own_nearest(coarse_map):
    centres, stored = all_poses(coarse_map)
    some = np.random.default_rng(2).integers(len(stored), size=50)
    stored /= np.linalg.norm(stored, axis=1, keepdims=True)
    nearest = nearest_poses(coarse_map, centres[some], stored[some])
    assert np.array_equal(nearest.row, some)
    assert nearest.distance == pytest.approx(0, abs=1e-9) and nearest.angle == pytest.approx(0, abs=1e-6)


def test_the_configuration_of_a_nearest_pose_reaches_its_cell(coarse_map):
    nearest = nearest_poses(coarse_map, *random_poses(60, half_width=1.5))
    reached, rotation = flange_frames(ROBOT, coarse_map.configurations(nearest.row))
    assert (np.abs(reached - nearest.positions) < GRID.cell_size / 2 + 1e-3).all()
    assert rotation[:, :, 2] == pytest.approx(nearest.directions, abs=2e-3)


def test_poses_that_are_none_are_refused(coarse_map):
    positions, directions = random_poses(3)
    with pytest.raises(ValueError, match="unit vectors. Row 0"):
        filter_grasps(coarse_map, positions, 2 * directions)
    with pytest.raises(ValueError, match="finite"):
        reach_along_path(coarse_map, np.full((3, 3), np.nan), directions)
    with pytest.raises(ValueError, match="metres_per_radian must be above 0. Got 0"):
        nearest_poses(coarse_map, positions, directions, 0.0)
