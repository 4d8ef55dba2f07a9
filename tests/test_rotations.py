import numpy as np
from scipy.spatial.transform import Rotation

from richmap.geometry.rotations import quaternions_of


def test_quaternions_are_those_of_scipy():
    half_turns = Rotation.from_rotvec(np.pi * np.concatenate([np.eye(3), [[0.6, 0.8, 0], [0, 0.6, 0.8]]]))
    for rotation in (Rotation.random(2000, random_state=0), half_turns, Rotation.identity(1)):
        quaternions, expected = quaternions_of(rotation.as_matrix()), rotation.as_quat(scalar_first=True)
        assert (quaternions[:, 0] >= 0).all()
        assert np.allclose(np.abs((quaternions * expected).sum(1)), 1, atol=1e-6)
