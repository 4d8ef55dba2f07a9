from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from richmap.counterparts.fraction_map import FULL, FractionConstruction, FractionMap, build_fraction_map
from richmap.motion.collision import self_collision
from richmap.motion.free_samples import free_samples
from richmap.motion.kinematics import flange_frames
from richmap.motion.turned_cells import NoTurnError, TurnedCells
from richmap.outputs import FileRefusedError
from richmap.robots.robots import load_robot

ROBOT = load_robot("iiwa7")
SETTINGS = FractionConstruction("iiwa7", ROBOT.fingerprint, cell_size=0.3, angles=6, samples=100_000, seed=0)


@pytest.fixture(scope="module")
def coarse_map():
    with ThreadPoolExecutor(1) as pool:
        return build_fraction_map(ROBOT, SETTINGS, pool)


@pytest.fixture
def poses():
    rng = np.random.default_rng(3)
    return rng.uniform(-1, 1, (500, 3)), Rotation.random(500, rng=rng).as_matrix()[:, :, 2]


def a_map(seed):
    """Some map on a few cells, for what does not depend on the arm."""
    rng = np.random.default_rng(seed)
    cells = TurnedCells(radius=0.8, bottom=-0.5, cell_size=0.4, shape=(4, 4, 3, 5))
    row = rng.permutation(48).reshape(4, 4, 3).astype(np.int32) - 8
    return FractionMap(cells, np.maximum(row, -1), rng.integers(0, FULL + 1, (40, 5), dtype=np.uint8), SETTINGS)


def score_slow(fraction_map, position, a):
    """Between the sixteen nearest centres; beyond the first and last angle as at them, beyond the cells nothing."""
    c, s = a[:2] / np.linalg.norm(a[:2])
    point = [c * position[0] + s * position[1], c * position[1] - s * position[0], position[2], np.arccos(a[2])]
    shape = fraction_map.cells.shape
    u = (np.array(point) - fraction_map.cells.lower) / fraction_map.cells.size
    if (u[:3] < 0).any() or (u[:3] >= shape[:3]).any():
        return 0.0
    u -= 0.5
    u[3] = np.clip(u[3], 0, shape[3] - 1 - 1e-12)
    total = 0.0
    for corner in product((0, 1), repeat=4):
        cell = np.floor(u).astype(int) + corner
        weight = np.prod(1 - np.abs(u - cell))
        if (cell[:3] >= 0).all() and (cell[:3] < shape[:3]).all() and fraction_map.row[tuple(cell[:3])] >= 0:
            total += weight * fraction_map.hits[fraction_map.row[tuple(cell[:3])], cell[3]] / FULL
    return total


def test_the_score_is_linear_between_the_cells(poses):
    fraction_map = a_map(0)
    slow = [score_slow(fraction_map, p, r) for p, r in zip(*poses, strict=True)]
    assert np.allclose(fraction_map.score(*poses), slow, atol=1e-5)


def test_turning_a_pose_about_the_base_axis_changes_nothing(poses):
    fraction_map, (position, direction) = a_map(1), poses
    about_z = Rotation.from_euler("z", np.random.default_rng(0).uniform(-np.pi, np.pi, (500, 1))).as_matrix()
    turned = (np.einsum("nij,nj->ni", about_z, vectors) for vectors in (position, direction))
    assert np.allclose(fraction_map.score(*turned), fraction_map.score(*poses), atol=1e-5)


def test_single_precision_gives_the_same_answers(poses):
    fraction_map = a_map(2)
    single = (array.astype(np.float32) for array in poses)
    assert np.allclose(fraction_map.score(*single), fraction_map.score(*poses), atol=1e-4)


def test_nothing_is_reachable_outside(poses):
    far = poses[0] + [0, 0, 5]
    assert (a_map(0).score(far, poses[1]) == 0).all()
    assert not a_map(0).reachable(far, poses[1]).any()


def test_the_threshold_is_the_best_one_on_the_poses_it_is_chosen_on(poses):
    fraction_map = a_map(0)
    labels = fraction_map.score(*poses) + np.random.default_rng(0).normal(0, 0.1, 500) > 0.3
    chosen = fraction_map.with_threshold_from(*poses, labels)
    wrong = [(replace(fraction_map, threshold=t).reachable(*poses) != labels).sum() for t in np.linspace(0.01, 1, 100)]
    assert (chosen.reachable(*poses) != labels).sum() <= min(wrong)
    strict = fraction_map.with_threshold_from(*poses, labels, negatives=20.0)
    assert strict.threshold >= chosen.threshold


@pytest.mark.system
def test_most_poses_that_the_arm_takes_are_found_and_few_beyond_its_reach(coarse_map):
    joints = np.random.default_rng(5).uniform(ROBOT.lower, ROBOT.upper, (2000, 7))
    joints = joints[~self_collision(ROBOT)(joints)]
    position, rotation = flange_frames(ROBOT, joints)
    assert coarse_map.reachable(position, rotation[:, :, 2]).mean() > 0.65
    away = position + 2 * (position - [0, 0, 0.34])
    beyond = np.linalg.norm(away - [0, 0, 0.34], axis=1) > 1.1
    assert coarse_map.reachable(away[beyond], rotation[beyond, :, 2]).mean() < 0.03


def test_reading_a_map_back(tmp_path, coarse_map, poses):
    coarse_map = replace(coarse_map, threshold=0.4375)
    coarse_map.save(tmp_path / "map.safetensors")
    other = FractionMap.load(tmp_path / "map.safetensors", ROBOT)
    assert other.construction == coarse_map.construction and other.cells == coarse_map.cells
    assert other.threshold == coarse_map.threshold
    assert np.array_equal(other.score(*poses), coarse_map.score(*poses))


def test_a_file_of_another_robot_or_cut_short_is_refused(tmp_path, coarse_map):
    file = tmp_path / "map.safetensors"
    coarse_map.save(file)
    with pytest.raises(FileRefusedError, match="is a map of iiwa7 .* not of gen3"):
        FractionMap.load(file, load_robot("gen3"))
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(FileRefusedError, match="cut short"):
        FractionMap.load(file)


def test_an_arm_whose_first_joint_turns_too_little_is_refused():
    narrow = ROBOT.urdf.replace('lower="-2.96706"', 'lower="-1.0"', 1)
    robot = replace(ROBOT, urdf=narrow)
    assert robot.lower[0] == -1.0
    with pytest.raises(NoTurnError, match="227 degrees"):
        TurnedCells.around(robot, 0.3, 6)


def test_samples_lie_in_their_cells_and_are_free():
    cells = TurnedCells.around(ROBOT, 0.2, 9)
    with ThreadPoolExecutor(1) as pool:
        cell, joints = free_samples(ROBOT, cells, 20_000, 0, pool)
    position, rotation = flange_frames(ROBOT, joints)
    assert np.array_equal(cells.cells_of(position, rotation[:, :, 2]), cell)
    assert not self_collision(ROBOT)(joints).any()
    assert ((joints >= ROBOT.lower) & (joints <= ROBOT.upper)).all()
