"""A second opinion on where an arm's flange is: two libraries read its URDF, and a map is built where they agree."""

from functools import lru_cache

import numpy as np

from richmap.motion.kinematics import flange_frames
from richmap.robots.robot import RobotDescription

SAMPLES = 64
"""Postures that are compared."""
TOLERANCE = 1e-5
"""Most that they may differ in any entry of the pose, positions in [m]; pytorch-kinematics keeps constants in single
precision."""


@lru_cache
def check_kinematics(robot: RobotDescription) -> None:
    """Compare our forward kinematics, which read an arm through Pinocchio, with those of pytorch-kinematics.

    Raises:
        ValueError: If they put the flange elsewhere.
    """
    import torch

    lower, upper = (np.clip(limits, -np.pi, np.pi) for limits in (robot.lower, robot.upper))  # Some have none.
    joints = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(robot.joints)))
    position, rotation = flange_frames(robot, joints)
    chain = robot.chain().to(dtype=torch.float64)
    with torch.inference_mode(False), torch.no_grad():
        pose = chain.forward_kinematics(torch.as_tensor(joints)).get_matrix().numpy()
    apart = max(np.abs(position - pose[:, :3, 3]).max(), np.abs(rotation - pose[:, :3, :3]).max())
    if not apart < TOLERANCE:
        raise ValueError(
            f"{robot.name}: Pinocchio and pytorch-kinematics read its URDF otherwise: its flange comes out up to "
            f"{apart:.2g} apart (m, or parts of 1 in its axes). No map is built of an arm that is not understood."
        )
