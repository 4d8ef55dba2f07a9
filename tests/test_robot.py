import mujoco
import numpy as np
import pytest
import torch

from richmap.mujoco_model import arm_spec
from richmap.robot import ROBOTS, load_robot
from richmap.sampling import flange_poses

UR_DH = {  # d1, a2, a3, d4, d5, d6 as published by Universal Robots for the CB series, in [m]
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
}


@pytest.fixture(params=ROBOTS)
def robot(request):
    return load_robot(request.param)


def random_joints(robot, n):
    return np.random.default_rng(1).uniform(robot.lower, robot.upper, (n, len(robot.joints)))


def test_pytorch_kinematics_and_mujoco_agree_on_the_flange(robot):
    model = arm_spec(robot).compile()
    data = mujoco.MjData(model)
    joints = random_joints(robot, 200)
    pose = robot.chain().to(dtype=torch.float64).forward_kinematics(torch.tensor(joints)).get_matrix().numpy()
    for q, expected in zip(joints, pose, strict=True):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        flange = data.body(robot.end_effector)
        assert np.linalg.norm(flange.xpos - expected[:3, 3]) < 1e-6
        turn = flange.xmat.reshape(3, 3).T @ expected[:3, :3]
        assert np.linalg.norm(turn - turn.T) / np.sqrt(8) < 1e-6  # sine of the angle between the two


@pytest.mark.parametrize("name", UR_DH)
def test_ur_arms_have_their_published_denavit_hartenberg_parameters(name):
    d1, a2, a3, d4, d5, d6 = UR_DH[name]
    rows = [(0, d1, 1), (a2, 0, 0), (a3, 0, 0), (0, d4, 1), (0, d5, -1), (0, d6, 0)]  # a, d, alpha / (pi / 2)
    robot = load_robot(name)
    joints = random_joints(robot, 50)
    position, direction = flange_poses(robot, joints)
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])  # The URDF's base frame faces the other way.
    for q, p, v in zip(joints, position, direction, strict=True):
        pose = half_turn
        # The URDF's zero has upper arm and second wrist turned a quarter against the DH convention's.
        for angle, (a, d, alpha) in zip(q, rows, strict=True):
            pose = pose @ dh_matrix(a, d, alpha * np.pi / 2, angle)
        assert np.linalg.norm(pose[:3, 3] - p) < 1e-4
        assert np.linalg.norm(pose[:3, 2] - v) < 1e-4


def dh_matrix(a, d, alpha, theta):
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    )


def test_limits_are_those_of_the_data_sheets():
    assert np.allclose(load_robot("ur5").upper, [2 * np.pi, 2 * np.pi, np.pi, 2 * np.pi, 2 * np.pi, 2 * np.pi])
    assert np.allclose(load_robot("xarm6").lower[1:3], [-2.059, -3.927])


def test_fingerprints_tell_robots_apart():
    assert len({load_robot(name).fingerprint for name in ROBOTS}) == len(ROBOTS)


def test_an_unknown_robot_is_refused_with_those_that_exist():
    with pytest.raises(ValueError, match="'ur7'.*xarm6, ur3, ur5, ur10"):
        load_robot("ur7")
