import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from richmap.geometry.rotations import capacity_bound_so3, quaternions_of, rotation_angle


def test_the_papers_bound():
    assert capacity_bound_so3(0.4) == pytest.approx(2361, abs=1)


def test_one_rotation_fits_where_every_other_is_too_near():
    assert capacity_bound_so3(2 * np.pi) == pytest.approx(1)


def test_quaternions_are_those_of_scipy():
    half_turns = Rotation.from_rotvec(np.pi * np.concatenate([np.eye(3), [[0.6, 0.8, 0], [0, 0.6, 0.8]]]))
    for rotation in (Rotation.random(2000, random_state=0), half_turns, Rotation.identity(1)):
        quaternions, expected = quaternions_of(rotation.as_matrix()), rotation.as_quat(scalar_first=True)
        assert (quaternions[:, 0] >= 0).all()
        assert np.allclose(np.abs((quaternions * expected).sum(1)), 1, atol=1e-6)


def test_the_angle_is_that_of_the_turn_between_two_rotations():
    a, b = Rotation.random(500, random_state=1), Rotation.random(500, random_state=2)
    angle = rotation_angle(a.as_quat(), -b.as_quat())
    assert np.allclose(angle, (a.inv() * b).magnitude(), atol=1e-6)
    assert rotation_angle(a.as_quat(), a.as_quat()) == pytest.approx(0, abs=1e-6)
