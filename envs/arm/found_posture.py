"""In which branch an arm does a task best: found at the task's start, from many postures.

A branch is a way of holding the tool that no small movement turns into another: elbow up or down, wrist in or out,
shoulder ahead or behind. An arm of seven joints has a range of postures in each.
"""

import json
from dataclasses import asdict, replace
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import platformdirs
from jaxtyping import Bool, Float, Int

from envs.arm.feasibility import followed
from envs.arm.placed_arm import PlacedArm, rounded_posture
from envs.arm.task_poses import TaskPoses
from richmap.cache import made_from
from richmap.given_files import given_json
from richmap.motion.collision import self_collision
from richmap.motion.ground import lowest_points
from richmap.motion.inverse_kinematics import ANGLE_TOLERANCE, POSITION_TOLERANCE, refine, starting_configurations
from richmap.outputs import replacing

VERSION = 1
"""Raised where another posture is found."""
STARTS = 256
"""Configurations from which the start is sought."""
ALIKE = 0.05
"""Of rough postures that differ by about this, in [rad], one is gone on with."""
APART = 0.3
"""Postures whose joints differ by no more than this, in [rad], are of one branch; so are those linked by such."""
JUDGED = 12
"""Postures that are judged at most: the least strained of every branch, then the second of each, and so on."""
AS_GOOD = 0.01
"""Shares that differ by no more than this are alike; the posture that is farther from its joints' limits is taken."""


def find_posture(arm: PlacedArm, poses: TaskPoses) -> PlacedArm:
    """The arm in the branch from which it does most of the task; from the user's cache once it was found.

    Raises:
        ValueError: If it cannot hold its tool upright over the task's start.
    """
    asked = {name: value for name, value in asdict(poses).items() if name != "branch" and value is not None}
    key = made_from(arm.numbers() | {"poses": asked}, VERSION)
    file = Path(platformdirs.user_cache_dir("richmap"), "postures", f"{arm.robot}-{key[:16]}.json")
    if not file.exists():
        posture = rounded_posture(best_posture(arm, poses))
        with replacing(file) as path:
            path.write_text(json.dumps(posture))
    try:
        stored = np.array(given_json(file), dtype=float)
        if stored.shape != (len(arm.description.joints),) or not np.isfinite(stored).all():
            raise ValueError("it holds no angle of each joint")
    except (ValueError, TypeError) as error:
        raise ValueError(f"{file} is damaged ({error}). Delete it.") from error
    return replace(arm, posture=tuple(stored.tolist()))


def best_posture(arm: PlacedArm, poses: TaskPoses) -> Float[np.ndarray, " dof"]:
    """The best of `branch_postures`, in [rad]; see `find_posture`."""
    postures = branch_postures(arm, poses)
    if len(postures) == 0:
        raise ValueError(
            f"{arm.robot} with its base at {arm.base} m can hold the tool upright over the start {poses.start[:2]} m "
            "in none of its postures. Choose another base, by arm.base=[x,y,z] (in m) and arm.yaw (in rad)."
        )
    shares = np.array([share_done(replace(arm, posture=tuple(posture)), poses) for posture in postures])
    alike = np.flatnonzero(shares >= shares.max() - AS_GOOD)
    return postures[alike[np.argmin(strain(arm, postures[alike]))]]


def branch_postures(arm: PlacedArm, poses: TaskPoses) -> Float[np.ndarray, "n dof"]:
    """Joint angles over the task's start, in [rad]: one of each branch, some of each if the arm has many.

    They are free of self-collision where it binds, within the joint limits, and above the ground.
    """
    kinematics = arm.kinematics()
    found = [kinematics.solve(np.array(poses.start), start, 100, np.inf) for start in _roughly(arm, poses)]
    exact = [posture.joints for posture in found if posture.residual < 1e-5 and posture.tilt < 1e-4]
    joints = nearest_to_middle(arm, np.array(exact).reshape(-1, len(arm.description.joints)))
    joints = joints[_holdable(arm, joints)]
    joints = joints[np.argsort(strain(arm, joints), kind="stable")]
    branch = branches(joints)
    place = np.array([(branch[:i] == branch[i]).sum() for i in range(len(joints))], dtype=int)  # Within its branch.
    if joints.shape[1] <= 6:
        return joints[place == 0]
    return joints[np.argsort(place, kind="stable")[:JUDGED]]


def branches(joints: Float[np.ndarray, "n dof"]) -> Int[np.ndarray, " n"]:
    """Which branch each of some postures is of, by single linkage; full turns of a joint change nothing."""
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(joints) < 2:
        return np.ones(len(joints), dtype=int)
    i, j = np.triu_indices(len(joints), 1)
    apart = np.abs((joints[i] - joints[j] + np.pi) % (2 * np.pi) - np.pi).max(1)
    return fcluster(linkage(apart, "single"), APART, "distance")


def share_done(arm: PlacedArm, poses: TaskPoses) -> float:
    """How much of the task the arm does from its posture, from 0 to 1."""
    if poses.share_done is not None:
        return float(resolve_name(poses.share_done)(arm))
    return followed_share(arm, poses)


def followed_share(arm: PlacedArm, poses: TaskPoses) -> float:
    """Share of the task's poses that the arm follows from its posture, within what binds and above the ground."""
    reached, joints = followed(arm, poses.points(), poses.start[2])
    reached[reached] = _holdable(arm, joints[reached])
    return float(reached.mean())


def strain(arm: PlacedArm, joints: Float[np.ndarray, "n dof"]) -> Float[np.ndarray, " n"]:
    """How far joints are from the middle of their range: the root of the mean square of shares of its half."""
    lower, upper = arm.joint_range
    return np.sqrt((((joints - (lower + upper) / 2) / ((upper - lower) / 2)) ** 2).mean(1))


def nearest_to_middle(arm: PlacedArm, joints: Float[np.ndarray, "n dof"]) -> Float[np.ndarray, "n dof"]:
    """The same postures, each joint turned by full turns to where it is nearest to the middle of its range."""
    lower, upper = arm.joint_range
    middle = (lower + upper) / 2
    return joints - 2 * np.pi * np.round((joints - middle) / (2 * np.pi))


def _roughly(arm: PlacedArm, poses: TaskPoses) -> Float[np.ndarray, "n dof"]:
    """Configurations near to holding the tool upright over the start, from starts all over the joints' range."""
    robot = arm.description
    starts = starting_configurations(robot, STARTS, seed=0)
    c, s = np.cos(arm.yaw), np.sin(arm.yaw)
    to_base = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    point, down = to_base @ (np.array(poses.start) - arm.kinematic_base), to_base @ np.diag([-1.0, 1.0, -1.0])
    points, free = np.tile(point, (STARTS, 1)), len(robot.joints) < 6  # as `InverseKinematics` has it
    joints, off, turned = refine(robot, starts, points, np.tile(down, (STARTS, 1, 1)), 100, free)
    joints = nearest_to_middle(arm, joints[(off <= POSITION_TOLERANCE) & (turned <= ANGLE_TOLERANCE)])
    return joints[np.unique(np.round(joints / ALIKE), axis=0, return_index=True)[1]]


def _holdable(arm: PlacedArm, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
    """Within the joint limits, no link that moves below the table, at z = 0, and free of self-collision if it binds."""
    robot, (lower, upper) = arm.description, arm.joint_range
    fine = ((joints >= lower) & (joints <= upper)).all(1)
    fine &= lowest_points(robot, joints) + arm.base[2] >= 0
    if arm.self_collision:
        fine &= ~self_collision(robot)(joints)
    return fine
