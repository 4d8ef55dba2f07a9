"""How far an arm reaches: the ball that holds its flange, and poses that are beyond it for certain."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from richmap.motion.kinematics import flange_frames, joint_frames
from richmap.robots.robot import RobotDescription


@lru_cache
def reach_ball(robot: RobotDescription) -> tuple[Float[np.ndarray, " 3"], float]:
    """Smallest ball about the shoulder that holds every position of the flange within the joint limits.

    Returns:
        The shoulder, a point on the first axis, in the base frame, and the radius, both in [m].
    """
    shoulder, _, _ = _longest_chain(robot)
    rng = np.random.default_rng(0)
    joints = rng.uniform(robot.lower, robot.upper, (20_000, len(robot.joints)))

    def nearness(q: Float[np.ndarray, " dof"]) -> float:
        return -float(np.linalg.norm(flange_frames(robot, q[None])[0][0] - shoulder))

    far = np.argsort(-np.linalg.norm(flange_frames(robot, joints)[0] - shoulder, axis=1))[:5]
    limits = list(zip(robot.lower, robot.upper, strict=True))
    return shoulder, -min(minimize(nearness, joints[i], method="L-BFGS-B", bounds=limits).fun for i in far)


def beyond_reach(
    robot: RobotDescription, positions: Float[np.ndarray, "n 3"], rotations: Float[np.ndarray, "n 3 3"], off: float
) -> Bool[np.ndarray, " n"]:
    """Poses that no configuration comes within `off` of, whatever the joint limits and the roll.

    A point on the last axis is never farther from the shoulder than a chain of straight lines from each axis to the
    next one is long; those lines keep their length while the joints turn.

    Args:
        robot: The arm.
        positions: Flange positions in the base frame, in [m].
        rotations: Flange orientations in the base frame (columns: its axes).
        off: Distance by which the point on the last axis may miss its place, in [m].
    """
    shoulder, wrist, length = _longest_chain(robot)
    aside = np.hypot(wrist[0], wrist[1])  # The last axis need not be the approach direction.
    points = positions + wrist[2] * rotations[:, :, 2]
    return np.linalg.norm(points - shoulder, axis=1) > length + aside + off


def wrist_offset(robot: RobotDescription) -> float:
    """Distance of the wrist (the point on the last axis of `beyond_reach`) from the flange, in [m]."""
    return float(np.linalg.norm(_longest_chain(robot)[1]))


@lru_cache
def _longest_chain(
    robot: RobotDescription,
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"], float]:
    """Shoulder in the base frame, wrist in the flange's frame, and the length of the chain between them, in [m].

    Any point on each axis gives a chain; these are those of the shortest one.
    """
    frames = joint_frames(robot)

    def lengths(along: Float[np.ndarray, " dof"]) -> Float[np.ndarray, " lines"]:
        ends = frames[1:-1, :, 3] + frames[1:-1, :, 2] * along[1:, None]
        ends[:, 2] -= along[:-1]
        return np.linalg.norm(ends, axis=1)

    start = np.zeros(len(frames) - 1)
    # Axes that meet have lines of length 0, where the length has no slope: hence the search without slopes.
    along = minimize(lambda x: lengths(x).sum(), start, method="Powell", options={"xtol": 1e-9, "ftol": 1e-12}).x
    shoulder = frames[0, :, 3] + frames[0, :, 2] * along[0]
    wrist = frames[-1, :, :3].T @ (np.array([0, 0, along[-1]]) - frames[-1, :, 3])
    return shoulder, wrist, float(lengths(along).sum())
