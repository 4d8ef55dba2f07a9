"""Closed-form inverse kinematics, for the arms that have it: all branches, by subproblem decomposition (EAIK)."""

from functools import lru_cache

import numpy as np
from eaik.IK_HP import HPRobot
from jaxtyping import Bool, Float

from richmap.motion.collision import self_collision
from richmap.motion.inverse_kinematics import ANGLE_TOLERANCE, POSITION_TOLERANCE
from richmap.motion.kinematics import flange_frames, joint_frames
from richmap.robots.robot import RobotDescription

BRANCHES = 8
"""An arm of six joints whose decomposition is known has at most so many."""


def has_closed_form(robot: RobotDescription) -> bool:
    """Whether EAIK can decompose the arm; it can where three axes that follow each other are parallel or meet."""
    return _decomposition(robot) is not None


def branches(
    robot: RobotDescription, positions: Float[np.ndarray, "n 3"], rotations: Float[np.ndarray, "n 3 3"]
) -> tuple[Float[np.ndarray, "n branches dof"], Bool[np.ndarray, "n branches"]]:
    """Every configuration within the joint limits that reaches each pose within the strict tolerance.

    Whole turns of a joint give the same posture, so that each branch is given once.

    Args:
        robot: The arm.
        positions: Flange positions in the base frame, in [m].
        rotations: Flange orientations in the base frame (columns: its axes).

    Returns:
        Configurations, in [rad], and which of them there are; the other rows mean nothing.

    Raises:
        ValueError: If the arm has no closed form.
    """
    decomposition = _decomposition(robot)
    if decomposition is None:
        raise ValueError(f"{robot.name} has no closed form. Use richmap.motion.inverse_kinematics.solve.")
    model, home = decomposition
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations @ home.T, positions
    joints = np.full((len(positions), BRANCHES, len(robot.joints)), np.nan)
    for row, solution in zip(joints, model.IK_batched(list(poses), 1), strict=True):
        found = np.array(solution.Q).reshape(-1, len(robot.joints))
        row[: len(found)] = found
    joints = robot.lower + np.mod(joints - robot.lower, 2 * np.pi)
    valid = (joints <= robot.upper).all(-1)  # False where there is none: NaN.
    # Where a pose has no exact solution, EAIK gives the best compromise of a subproblem.
    of, branch = np.nonzero(valid)
    p, r = flange_frames(robot, joints[of, branch])
    cosine = (np.einsum("nij,nij->n", r, rotations[of]) - 1) / 2
    near = np.linalg.norm(p - positions[of], axis=1) <= POSITION_TOLERANCE
    valid[of, branch] = near & (np.arccos(np.clip(cosine, -1, 1)) <= ANGLE_TOLERANCE)
    return joints, valid


def solve_closed_form(
    robot: RobotDescription, positions: Float[np.ndarray, "n 3"], rotations: Float[np.ndarray, "n 3 3"]
) -> tuple[Float[np.ndarray, "n dof"], Bool[np.ndarray, " n"]]:
    """The first branch that is within the limits and free of self-collision, as `inverse_kinematics.solve` gives it.

    Raises:
        ValueError: If the arm has no closed form.
    """
    all_joints, valid = branches(robot, positions, rotations)
    joints, solved = np.zeros((len(positions), len(robot.joints))), np.zeros(len(positions), dtype=bool)
    check = self_collision(robot)
    first = np.arange(BRANCHES) == 0
    for some in (first, ~first):  # Most poses need one branch, and few large checks cost less than many.
        of, which = np.nonzero(valid & some & ~solved[:, None])
        found = all_joints[of, which]
        free = ~check(found)
        joints[of[free]], solved[of[free]] = found[free], True
    return joints, solved


@lru_cache
def _decomposition(robot: RobotDescription) -> tuple[HPRobot, Float[np.ndarray, "3 3"]] | None:
    """EAIK's model of the arm, whose flange is parallel to the base at zero, and the flange's orientation there."""
    if len(robot.joints) != 6:
        return None
    position, rotation = np.zeros(3), np.eye(3)
    axes, origins = [], []
    for frame in joint_frames(robot):
        position, rotation = position + rotation @ frame[:, 3], rotation @ frame[:, :3]
        axes.append(rotation[:, 2])
        origins.append(position)
    model = HPRobot(np.array(axes[:-1]), np.diff(origins, axis=0, prepend=np.zeros((1, 3))))
    return (model, rotation) if model.hasKnownDecomposition() else None
