from functools import reduce

import mujoco
import numpy as np
import pytest
import torch

from richmap.motion.kinematics import flange_frames
from richmap.physics.mujoco_model import arm_spec
from richmap.robots.robots import ROBOTS, load_robot
from tests.eight_arms import EIGHT

UR_DH = {  # d1, a2, a3, d4, d5, d6 as published by Universal Robots, in [m]
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
}


@pytest.fixture(params=EIGHT)
def robot(request):
    return load_robot(request.param)


def random_joints(robot, n):
    return np.random.default_rng(1).uniform(robot.lower, robot.upper, (n, len(robot.joints)))


@pytest.mark.system
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
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])  # The URDF's base frame faces the other way.

    def flange(q):
        return half_turn @ product(
            dh_matrix(a, d, alpha * np.pi / 2, t) for (a, d, alpha), t in zip(rows, q, strict=True)
        )

    assert_flange(name, flange, 1e-6 if name == "ur5e" else 1e-4)


def test_panda_has_its_published_denavit_hartenberg_parameters():
    """Franka's documentation gives them in Craig's convention; the last row is the flange."""
    rows = [(0, 0.333, 0), (0, 0, -1), (0, 0.316, 1), (0.0825, 0, 1), (-0.0825, 0.384, -1), (0, 0, 1), (0.088, 0, 1)]

    def flange(q):
        joints = (craig_matrix(a, d, alpha * np.pi / 2, t) for (a, d, alpha), t in zip(rows, q, strict=True))
        return product(joints) @ craig_matrix(0, 0.107, 0, 0)

    assert_flange("panda", flange, 1e-6)


def test_iiwa7_has_its_published_denavit_hartenberg_parameters():
    """Faria et al. 2018 (base to shoulder 340, shoulder to elbow 400, elbow to wrist 400, wrist to flange 126 mm)."""
    rows = [(0.34, -1), (0, 1), (0.4, 1), (0, -1), (0.4, -1), (0, 1), (0.126, 0)]  # d, alpha / (pi / 2)

    def flange(q):
        return product(dh_matrix(0, d, alpha * np.pi / 2, t) for (d, alpha), t in zip(rows, q, strict=True))

    assert_flange("iiwa7", flange, 1e-6)


def test_gen3_has_its_published_denavit_hartenberg_parameters():
    """Kinova's user guide, lengths to 0.1 mm each, so that the flange agrees to half a millimetre."""
    lengths = [-(0.1564 + 0.1284), -(0.0054 + 0.0064), -(0.2104 + 0.2104), -(0.0064 + 0.0064), -(0.2084 + 0.1059), 0,
               -(0.1059 + 0.0615)]  # fmt: skip
    twists = [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 1]

    def flange(q):
        angles = q + np.pi * np.array([0, 1, 1, 1, 1, 1, 1])
        joints = (dh_matrix(0, d, twist * np.pi, t) for d, twist, t in zip(lengths, twists, angles, strict=True))
        return dh_matrix(0, 0, np.pi, 0) @ product(joints)

    assert_flange("gen3", flange, 5e-4, 1e-6)


def assert_flange(name, flange, length, angle=None):
    """Position and approach direction of the flange agree at random configurations."""
    robot = load_robot(name)
    joints = random_joints(robot, 50)
    position, rotation = flange_frames(robot, joints)
    pose = np.array([flange(q) for q in joints])
    assert np.linalg.norm(pose[:, :3, 3] - position, axis=1).max() < length
    assert np.linalg.norm(pose[:, :3, 2] - rotation[:, :, 2], axis=1).max() < (angle or length)


def product(matrices):
    return reduce(np.matmul, matrices)


def craig_matrix(a, d, alpha, theta):
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[ct, -st, 0, a], [st * ca, ct * ca, -sa, -d * sa], [st * sa, ct * sa, ca, d * ca], [0, 0, 0, 1]])


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


def test_continuous_joints_are_sampled_over_one_turn():
    robot = load_robot("gen3")
    assert np.allclose(robot.upper[::2], np.pi) and np.allclose(robot.lower[::2], -np.pi)
    assert np.allclose(robot.upper[1::2], [2.41, 2.66, 2.23])


def test_fingerprints_tell_robots_apart():
    assert len({load_robot(name).fingerprint for name in ROBOTS}) == len(ROBOTS)


def test_an_unknown_robot_is_refused_with_those_that_exist():
    with pytest.raises(ValueError, match="'ur7'.*gen3, iiwa14, .*xarm7, z1"):
        load_robot("ur7")
