"""The branch of an arm's kinematics that a configuration is in."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float

from richmap.motion.kinematics import joint_frames
from richmap.robots.robot import JOINTS_OF_BRANCHES as JOINTS
from richmap.robots.robot import RobotDescription

PLACES = 256
"""At which the determinant is looked at on the line between two configurations: between two of them it may change its
sign twice unseen."""
STRIDE = 8
"""Of these every eighth is looked at first, and then all, as most lines to other branches show early."""


def in_branch(robot: RobotDescription, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
    """Whether configurations are in the branch of the arm's `posture`: it gets there without passing a singularity.

    An arm of six joints is in another branch of its kinematics where the determinant of its Jacobian has another sign,
    or where it would have to pass one between (Borrel and Liegeois, ICRA 1986, call such a region an aspect). Here that
    is looked at on the straight line between the two, so that a configuration that only a way round leads to is left
    out. Of an arm without a posture all configurations are.

    Args:
        robot: The arm.
        joints: In [rad].
    """
    inside = np.ones(len(joints), dtype=bool)
    if robot.posture:
        _in_branch(joint_frames(robot), np.array(robot.posture), np.ascontiguousarray(joints, np.float64), inside)
    return inside


def one_turn(robot: RobotDescription) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
    """Limits between which samples of the branch are drawn, in [rad]: those of the joints, but one turn at most about
    the arm's `posture`, as further turns of a joint lead to no other pose."""
    if not robot.posture:
        return robot.lower, robot.upper
    width = np.minimum(robot.upper - robot.lower, 2 * np.pi)
    lower = np.clip(np.array(robot.posture) - np.pi, robot.lower, robot.upper - width)
    return lower, lower + width


@numba.njit(cache=True, nogil=True)
@no_type_check
def _in_branch(frames, posture, joints, inside):
    jacobian, q, p, r = np.empty((JOINTS, JOINTS)), np.empty(JOINTS), np.empty(3), np.empty((3, 3))
    of_posture = _sign(frames, posture, jacobian, p, r)
    for i in range(len(joints)):
        for k in range(PLACES + PLACES // STRIDE):
            place = STRIDE * k if k < PLACES // STRIDE else k - PLACES // STRIDE
            share = 1 - place / PLACES  # From the far end on, where most of those that are not inside differ.
            for j in range(JOINTS):
                q[j] = posture[j] + share * (joints[i, j] - posture[j])
            if _sign(frames, q, jacobian, p, r) != of_posture:
                inside[i] = False
                break


@numba.njit(cache=True, nogil=True)
@no_type_check
def _sign(frames, q, jacobian, p, r):
    """Whether the determinant of the Jacobian is above 0: that of the point of the flange that is at the base's origin,
    as it is the same for any of its points. A row is a joint."""
    p[:], r[:] = frames[0, :, 3], frames[0, :, :3]
    for j in range(JOINTS):
        jacobian[j, 0] = p[1] * r[2, 2] - p[2] * r[1, 2]
        jacobian[j, 1] = p[2] * r[0, 2] - p[0] * r[2, 2]
        jacobian[j, 2] = p[0] * r[1, 2] - p[1] * r[0, 2]
        c, s, f = np.cos(q[j]), np.sin(q[j]), frames[j + 1]
        for a in range(3):
            jacobian[j, 3 + a] = r[a, 2]
            x, y, z = c * r[a, 0] + s * r[a, 1], c * r[a, 1] - s * r[a, 0], r[a, 2]
            p[a] += x * f[0, 3] + y * f[1, 3] + z * f[2, 3]
            for b in range(3):
                r[a, b] = x * f[0, b] + y * f[1, b] + z * f[2, b]
    return _positive(jacobian)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _positive(matrix):
    """Whether a determinant is above 0, by elimination in the matrix itself, a quarter of what LAPACK takes."""
    positive = True
    for k in range(JOINTS):
        pivot = k
        for i in range(k + 1, JOINTS):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            positive = not positive
            for j in range(k, JOINTS):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        if matrix[k, k] == 0:
            return False
        positive = positive == (matrix[k, k] > 0)
        for i in range(k + 1, JOINTS):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, JOINTS):
                matrix[i, j] -= factor * matrix[k, j]
    return positive
