import numpy as np
import pytest
import torch

from richmap.motion.kinematics import flange_frames
from richmap.robots.robots import ROBOTS, load_robot


@pytest.mark.parametrize("name", ROBOTS)
def test_agrees_with_pytorch_kinematics(name):
    robot = load_robot(name)
    joints = np.random.default_rng(1).uniform(robot.lower, robot.upper, (200, len(robot.joints)))
    position, rotation = flange_frames(robot, joints)
    pose = robot.chain().to(dtype=torch.float64).forward_kinematics(torch.as_tensor(joints)).get_matrix().numpy()
    assert np.allclose(position, pose[:, :3, 3], atol=5e-7)  # pytorch-kinematics keeps its constants in float32
    assert np.allclose(rotation, pose[:, :3, :3], atol=5e-7)
