from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from richmap.counterparts.rm4d import RM4D, RM4DConstruction, build_rm4d
from richmap.motion.kinematics import flange_frames
from richmap.motion.turned_cells import TurnedCells
from richmap.outputs import FileRefusedError
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system

ROBOT = load_robot("iiwa7")


@pytest.fixture(scope="module")
def small():
    with ThreadPoolExecutor(1) as pool:
        return build_rm4d(ROBOT, RM4DConstruction("iiwa7", ROBOT.fingerprint, 0, 0.2, 9, 50_000), pool)


def test_cells_are_those_of_the_definition():
    cells = TurnedCells(radius=1.05, bottom=0.0, cell_size=0.05, shape=(42, 42, 27, 36))
    rng = np.random.default_rng(0)
    position = rng.uniform(-0.65, 0.65, (200, 3)) + [0, 0, 0.67]
    direction = Rotation.random(200, rng=rng).as_matrix()[:, :, 2]
    for p, d, cell in zip(position, direction, cells.cells_of(position, direction), strict=True):
        azimuth = np.arctan2(d[1], d[0])
        x, y, _ = Rotation.from_euler("z", -azimuth).apply(p)
        degrees = np.degrees(np.arccos(d[2]))
        i, j, k, b = ((x + 1.05) // 0.05, (y + 1.05) // 0.05, p[2] // 0.05, degrees // 5)
        assert np.unravel_index(cell, cells.shape) == (i, j, k, b)


def test_what_is_marked_is_reachable_and_marked_cells_are_found(small):
    joints = np.random.default_rng(1).uniform(ROBOT.lower, ROBOT.upper, (2000, 7))
    position, rotation = flange_frames(ROBOT, joints)
    assert small.reachable(position, rotation[:, :, 2]).mean() > 0.9
    assert small.inserted == small.hit.sum() > 0


def test_nothing_is_reachable_outside(small):
    outside = np.array([[5.0, 0, 0], [0, 0, 5], [0, 0, -5]])
    assert not small.reachable(outside, np.tile([0.0, 0.0, 1.0], (3, 1))).any()


def test_reading_a_map_back(tmp_path, small):
    small.save(tmp_path / "map.safetensors")
    other = RM4D.load(tmp_path / "map.safetensors", ROBOT)
    assert np.array_equal(other.hit, small.hit)
    assert other.construction == small.construction
    with pytest.raises(FileRefusedError, match="not of another"):
        RM4D.load(tmp_path / "map.safetensors", replace(ROBOT, name="another", urdf=ROBOT.urdf + "<!-- another -->"))
