"""Random configurations of an arm that are within joint limits and free of self-collision, and their flange poses."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from richmap.collision import self_collision
from richmap.robot import RobotDescription


@dataclass(frozen=True)
class WorkspaceSamples:
    """Flange poses with the configurations that reach them."""

    joints: Float[np.ndarray, "n dof"]
    """Configurations, in [rad]."""
    position: Float[np.ndarray, "n 3"]
    """Origin of the flange in the base frame, in [m]."""
    direction: Float[np.ndarray, "n 3"]
    """Approach direction (flange +z) in the base frame, unit length."""
    independent: int
    """The first so many samples are drawn independently; the others turn some of them about joint 1."""


def sample_workspace(
    robot: RobotDescription, rng: np.random.Generator, configurations: int, turns: int
) -> WorkspaceSamples:
    """Draw configurations uniformly within the joint limits and keep those free of self-collision.

    Each free configuration is used again at up to `turns - 1` further angles of joint 1, spread over the circle, where
    it is known to stay free (orbit sampling; `SelfCollision.free_turns`).

    Args:
        robot: The arm; orbit sampling is used if its first axis is the base frame's z axis, up or down.
        rng: Source of randomness.
        configurations: Number of configurations to draw.
        turns: Angles of joint 1 per configuration; 1 switches orbit sampling off.
    """
    joints = rng.uniform(robot.lower, robot.upper, (configurations, len(robot.joints)))
    phase = rng.random((configurations, max(turns - 1, 0)))
    check = self_collision(robot)
    free = ~check(joints)
    joints, phase = joints[free], phase[free]
    position, direction = flange_poses(robot, joints)
    way = way_about_base_z(robot)
    if turns == 1 or way == 0:
        return _as_float32(joints, position, direction, len(joints))

    middle = (robot.lower[0] + robot.upper[0]) / 2
    width = min(robot.upper[0] - robot.lower[0], 2 * np.pi)
    angle = middle + width * ((np.arange(turns - 1) + phase) / (turns - 1) - 0.5)
    of, turn = np.nonzero(check.free_turns(joints, angle))
    turned = joints[of]
    turned[:, 0] = angle[of, turn]
    by = way * (turned[:, 0] - joints[of, 0])
    return _as_float32(
        np.concatenate([joints, turned]),
        np.concatenate([position, _rotate_about_z(position[of], by)]),
        np.concatenate([direction, _rotate_about_z(direction[of], by)]),
        len(joints),
    )


def flange_poses(
    robot: RobotDescription, joints: Float[np.ndarray, "n dof"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Position, in [m], and approach direction of the flange in the base frame, by pytorch-kinematics in float64."""
    import torch

    pose = _chain(robot).forward_kinematics(torch.as_tensor(joints)).get_matrix().numpy()
    return pose[:, :3, 3], pose[:, :3, 2]


def way_about_base_z(robot: RobotDescription) -> int:
    """How joint 1 turns the arm about the base frame's z axis: 1 counter-clockwise, -1 clockwise, 0 not about it."""
    rng = np.random.default_rng(0)
    joints = rng.uniform(robot.lower, robot.upper, (8, len(robot.joints)))
    before, after = flange_poses(robot, joints), flange_poses(robot, joints + np.eye(len(robot.joints))[0])
    for way in (1, -1):
        by = np.full(8, float(way))
        if all(np.allclose(_rotate_about_z(b, by), a, atol=1e-6) for b, a in zip(before, after, strict=True)):
            return way
    return 0


@lru_cache
def _chain(robot: RobotDescription):
    import torch

    return robot.chain().to(dtype=torch.float64)


def _rotate_about_z(vectors: Float[np.ndarray, "n 3"], by: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    c, s = np.cos(by), np.sin(by)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def _as_float32(joints, position, direction, independent: int) -> WorkspaceSamples:
    return WorkspaceSamples(
        joints.astype(np.float32), position.astype(np.float32), direction.astype(np.float32), independent
    )
