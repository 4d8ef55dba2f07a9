"""A ground that an arm's links stay above: an obstacle that looks the same at every angle of a vertical joint 1."""

from functools import lru_cache
from typing import no_type_check

import numba
import numpy as np
import pinocchio
from jaxtyping import Float, Int

from richmap.motion.kinematics import joint_frames, z_to_axis
from richmap.robots.robot import RobotDescription


def lowest_points(robot: RobotDescription, joints: Float[np.ndarray, "n dof"]) -> Float[np.ndarray, " n"]:
    """Height of the lowest point of any link that moves, in the base frame, in [m]; infinite if none has a shape.

    Args:
        robot: The arm.
        joints: Configurations, in [rad].
    """
    joint, corners = _corners(robot)
    return _lowest(np.ascontiguousarray(joints, dtype=np.float64), joint_frames(robot), joint, corners)


@lru_cache
def _corners(robot: RobotDescription) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Corners of the convex hulls of the moving links' shapes, in the frames of the joints that carry them, from 1."""
    model = pinocchio.buildModelFromXML(robot.urdf)
    joint, corners = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
    for link, shapes in robot.shapes.items():
        if robot.depth[link] == 0:
            continue
        frame = model.frames[model.getFrameId(link)]
        to_joint = z_to_axis(model.joints[frame.parentJoint]).inverse() * frame.placement
        for shape in shapes:
            hull = shape.triangles().convex_hull.vertices
            corners.append(hull @ to_joint.rotation.T + to_joint.translation)
            joint.append(np.full(len(hull), robot.depth[link]))
    joints = np.concatenate(joint)
    order = np.argsort(joints, kind="stable")
    return joints[order], np.concatenate(corners)[order]


@numba.njit(cache=True, nogil=True)
@no_type_check
def _lowest(joints, frames, joint, corners):
    """Only heights are followed: the third row of each joint's pose."""
    lowest = np.full(len(joints), np.inf)
    for i in range(len(joints)):
        x, y, z, height = frames[0, 2, 0], frames[0, 2, 1], frames[0, 2, 2], frames[0, 2, 3]
        k = 0
        for j in range(joints.shape[1]):
            c, s = np.cos(joints[i, j]), np.sin(joints[i, j])
            x, y = c * x + s * y, c * y - s * x
            while k < len(joint) and joint[k] == j + 1:
                lowest[i] = min(lowest[i], x * corners[k, 0] + y * corners[k, 1] + z * corners[k, 2] + height)
                k += 1
            f = frames[j + 1]
            height += x * f[0, 3] + y * f[1, 3] + z * f[2, 3]
            x, y, z = (
                x * f[0, 0] + y * f[1, 0] + z * f[2, 0],
                x * f[0, 1] + y * f[1, 1] + z * f[2, 1],
                x * f[0, 2] + y * f[1, 2] + z * f[2, 2],
            )
    return lowest
