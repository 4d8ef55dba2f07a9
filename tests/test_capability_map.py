from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from richmap.counterparts import capability_construction
from richmap.counterparts.capability_construction import (
    OrientationSamples,
    QuaternionInserter,
    build_capability_map,
    sample_orientations,
)
from richmap.counterparts.capability_map import CapabilityConstruction, CapabilityMap
from richmap.geometry.grid import Grid
from richmap.geometry.rotations import quaternions_of
from richmap.motion.kinematics import flange_frames
from richmap.outputs import FileRefusedError
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system

THETA = 0.6
CUBE = Grid((-0.1, -0.1, -0.1), 0.1, (2, 2, 2))
GRID = Grid.around_base(cell_size=0.25, half_width=1.0, z_offset=0.2)
ROBOT = load_robot("xarm6")
SETTINGS = CapabilityConstruction(
    "xarm6", ROBOT.fingerprint, THETA, seed=0, draw=400, turns=16, stop_rate=0.2, target=0
)
WORST_ROUNDING = 2e-3
"""Angle between two equal quaternions as float32 sees it, in [rad]."""


def random_samples(n, seed):
    rng = np.random.default_rng(seed)
    position = rng.uniform(-0.13, 0.13, (n, 3)).astype(np.float32)  # some outside the grid
    quaternion = quaternions_of(Rotation.random(n, random_state=seed).as_matrix())
    return OrientationSamples(position, quaternion, np.arange(n, dtype=np.uint16)[:, None])


def insert_slowly(batches):
    """Pose after pose, against everything in its cell."""
    kept = {}
    for batch in batches:
        for position, quaternion, joints in zip(batch.position, batch.quaternion, batch.joints, strict=True):
            cell = CUBE.cells_of(position[None])[0]
            if cell < 0:
                continue
            others = kept.setdefault(cell, [])
            if all(2 * np.arccos(min(abs(np.dot(quaternion, other)), 1)) >= THETA for other, _ in others):
                others.append((quaternion, joints[0]))
    return kept


def in_threads(workers, *_, **__):
    """Stands in for a pool of processes, which take seconds to start."""
    return ThreadPoolExecutor(workers)


def interrupt_the_third_draw(progress):
    if progress.draws == 3:
        raise KeyboardInterrupt


@pytest.fixture(scope="module")
def batches():
    return [random_samples(4000, seed) for seed in range(3)]


@pytest.fixture(scope="module")
def inserter(batches):
    inserter = QuaternionInserter(CUBE, THETA)
    for batch in batches:
        inserter.insert(batch)
    return inserter


@pytest.fixture(scope="module")
def coarse_map():
    return build_capability_map(ROBOT, GRID, SETTINGS, workers=1)


def capacity_bound(theta):
    """Upper bound on rotations with mutual separation `theta` (RichMap, "Full quaternion representation").

    SO(3) has volume pi^2 and a ball of radius psi has pi (psi - sin psi); balls of radius theta / 2 do not overlap.
    """
    return np.pi / (theta / 2 - np.sin(theta / 2))


def rotation_angle(a, b):
    return 2 * np.arccos(np.minimum(np.abs((a * b).sum(-1)), 1))


def alike(a, b):
    return (
        np.array_equal(a.start, b.start)
        and np.array_equal(a.quaternions, b.quaternions)
        and np.array_equal(a.joints, b.joints)
    )


def test_inserts_what_pose_after_pose_would(inserter, batches):
    cell, quaternion, joints = inserter.stored()
    for c, expected in insert_slowly(batches).items():
        assert (quaternion[cell == c] == np.array([q for q, _ in expected])).all()
        assert (joints[cell == c, 0] == [j for _, j in expected]).all()
    assert inserter.inserted == len(cell)
    assert inserter.occupancy == 1


def test_orientations_in_a_cell_are_theta_apart_and_within_capacity(inserter):
    cell, quaternion, _ = inserter.stored()
    for c in range(8):
        own = quaternion[cell == c]
        assert 100 < len(own) <= capacity_bound(THETA)  # more than a page
        angle = rotation_angle(own[:, None], own)
        assert angle[~np.eye(len(own), dtype=bool)].min() >= THETA - 1e-5


def test_a_full_cell_is_full_and_within_capacity():
    inserter = QuaternionInserter(Grid((-1.0, -1.0, -1.0), 2.0, (1, 1, 1)), 1.5)
    for seed in range(4):
        inserter.insert(random_samples(20_000, seed))
    assert not inserter.insert(random_samples(20_000, 4)).any()
    assert 0.25 < inserter.inserted / capacity_bound(1.5) < 1


def test_neither_interruptions_nor_the_number_of_workers_change_the_map(coarse_map, tmp_path, monkeypatch):
    monkeypatch.setattr(capability_construction, "SAVE_INTERVAL", 0)
    monkeypatch.setattr(capability_construction, "worker_pool", in_threads)
    file = tmp_path / "unfinished.safetensors"
    with pytest.raises(KeyboardInterrupt):
        build_capability_map(ROBOT, GRID, SETTINGS, 1, interrupt_the_third_draw, file)
    assert CapabilityMap.load(file).construction.draws == 2
    seen = []
    again = build_capability_map(ROBOT, GRID, SETTINGS, 3, seen.append, file)
    assert seen[0].draws == 3
    assert alike(again, coarse_map) and again.construction == coarse_map.construction
    assert not file.exists()


def test_an_unfinished_map_of_other_settings_is_not_gone_on_from(coarse_map, tmp_path, monkeypatch):
    monkeypatch.setattr(capability_construction, "worker_pool", in_threads)
    file = tmp_path / "unfinished.safetensors"
    coarse_map.save(file)
    settings = replace(SETTINGS, seed=1, target=coarse_map.inserted // 2)
    half = build_capability_map(ROBOT, GRID, settings, 1, unfinished=file)
    assert settings.target <= half.inserted < coarse_map.inserted
    assert not alike(half, coarse_map)


def test_the_map_says_how_full_it_is(coarse_map):
    assert 0 < coarse_map.construction.batch_rate < SETTINGS.stop_rate
    assert 0 < coarse_map.insertion_rate < 1
    filled = np.unique(np.repeat(np.arange(GRID.n_cells), np.diff(coarse_map.start)))
    assert coarse_map.occupancy == len(filled) / GRID.n_cells
    assert coarse_map.avg_per_cell == coarse_map.inserted / len(filled)


def test_each_orientation_is_that_of_its_configuration(coarse_map):
    joints = coarse_map.configurations(np.arange(coarse_map.inserted))
    assert (joints >= ROBOT.lower - 1e-9).all() and (joints <= ROBOT.upper + 1e-9).all()
    position, rotation = flange_frames(ROBOT, joints)
    cell = np.repeat(np.arange(GRID.n_cells), np.diff(coarse_map.start))
    assert (GRID.cells_of(position) == cell).mean() > 0.99  # but for rounding at a cell's face
    assert rotation_angle(quaternions_of(rotation), coarse_map.quaternions).max() < WORST_ROUNDING


def test_a_search_through_all_orientations_finds_the_same_poses_reachable(coarse_map):
    samples = sample_orientations(ROBOT, replace(SETTINGS, seed=9), 0)
    position, quaternion = samples.position[::10], samples.quaternion[::10]
    rotation = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    reachable = coarse_map.reachable(position, rotation)
    for cell, q, found in zip(GRID.cells_of(position), quaternion, reachable, strict=True):
        stored = coarse_map.quaternions[coarse_map.start[cell] : coarse_map.start[cell + 1]]
        least = rotation_angle(stored, q).min(initial=np.pi)
        assert found == (least < THETA) or least == pytest.approx(THETA, abs=WORST_ROUNDING)
    assert 0 < reachable.sum() < len(reachable)


def test_most_reachable_poses_are_found_and_points_outside_never(coarse_map):
    samples = sample_orientations(ROBOT, replace(SETTINGS, seed=9), 0)
    rotation = Rotation.from_quat(samples.quaternion, scalar_first=True).as_matrix()
    assert coarse_map.reachable(samples.position, rotation).mean() > 0.7
    far = samples.position + np.float32(10)
    assert not coarse_map.reachable(far, rotation).any()


def test_a_map_survives_the_file_and_broken_files_are_refused(coarse_map, tmp_path):
    file = tmp_path / "map.safetensors"
    coarse_map.save(file)
    again = CapabilityMap.load(file)
    assert alike(again, coarse_map)
    assert again.construction == coarse_map.construction
    with pytest.raises(FileRefusedError, match="not of ur3"):
        CapabilityMap.load(file, load_robot("ur3"))
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])
    with pytest.raises(FileRefusedError, match="cut short"):
        CapabilityMap.load(file)
    at = len(whole) - 50
    file.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(FileRefusedError, match="damaged"):
        CapabilityMap.load(file)
