import numpy as np
import pytest
import torch

from richmap.motion.kinematics import flange_frames
from richmap.motion.kinematics_check import check_kinematics
from richmap.robots.robots import load_robot
from tests.eight_arms import EIGHT


def test_what_two_libraries_read_otherwise_is_said_in_metres(monkeypatch):
    """They agree on what ships to single precision, and not beyond."""
    check_kinematics.cache_clear()
    monkeypatch.setattr("richmap.motion.kinematics_check.TOLERANCE", 1e-12)
    with pytest.raises(ValueError, match="ur5: Pinocchio and pytorch-kinematics read its URDF otherwise"):
        check_kinematics(load_robot("ur5"))
    monkeypatch.undo()
    check_kinematics(load_robot("ur5"))


@pytest.mark.parametrize("name", EIGHT)
def test_agrees_with_pytorch_kinematics(name):
    robot = load_robot(name)
    joints = np.random.default_rng(1).uniform(robot.lower, robot.upper, (200, len(robot.joints)))
    position, rotation = flange_frames(robot, joints)
    pose = robot.chain().to(dtype=torch.float64).forward_kinematics(torch.as_tensor(joints)).get_matrix().numpy()
    assert np.allclose(position, pose[:, :3, 3], atol=5e-7)  # pytorch-kinematics keeps its constants in float32
    assert np.allclose(rotation, pose[:, :3, :3], atol=5e-7)
