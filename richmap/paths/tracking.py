"""An arm that follows a path in one branch of its kinematics: from each configuration to the nearest next one."""

from enum import IntEnum
from functools import lru_cache
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int

from richmap.motion.inverse_kinematics import (
    ANGLE_TOLERANCE,
    ITERATIONS,
    LEVER,
    POSITION_TOLERANCE,
    Chain,
    Descent,
    configurations,
    descend,
    starting_configurations,
)
from richmap.motion.kinematics import joint_frames
from richmap.robots.robot import RobotDescription

STARTS = 64
"""Configurations from which those that reach a pose are sought."""

BRANCHES = 12
"""Configurations from which a path is followed at most; an arm of six joints has up to eight branches."""

FARTHEST = 0.3
"""What a joint moves at most from one place of a path to the next, in [rad]; more is a jump to another branch."""

FARTHEST_AFTER = 1.0
"""The same after a stretch that was not reached."""

PRECISION = 1e-6
"""To which the poses of a path are solved for where that can be, in [m] and [rad], so that speeds are exact."""


class Found(IntEnum):
    """Whether a branch has a configuration at a place of a path."""

    NOTHING = 0
    BEYOND_LIMITS = 1
    """Only with a joint beyond its limits."""
    WITHIN_LIMITS = 2


def branches_at(
    robot: RobotDescription,
    position: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"],
    free_roll: bool = False,
) -> Float[np.ndarray, "branches dof"]:
    """Configurations within the limits that reach a pose, in [rad], one of each branch; of seven joints, some of many.

    Each joint is turned by whole turns to where it is nearest to the middle of its range; the one whose joints are
    nearest to that comes first.
    """
    found = configurations(robot, _starts(robot), position[None], rotation[None], BRANCHES, free_roll)[0]
    found = found[~np.isnan(found[:, 0])]
    middle, half = (robot.lower + robot.upper) / 2, (robot.upper - robot.lower) / 2
    found = found - 2 * np.pi * np.round((found - middle) / (2 * np.pi))
    return found[np.argsort((((found - middle) / half) ** 2).sum(1), kind="stable")]


def follow(
    robot: RobotDescription,
    start: Float[np.ndarray, " dof"],
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"],
    free_roll: bool = False,
) -> tuple[Float[np.ndarray, "n dof"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Follow a path from a configuration on, each pose from the last one that was reached.

    An arm with more joints than a pose has numbers moves as little as it can, and keeps within its limits where that
    goes. One that would have to go on beyond a limit, and can do the same after a whole turn of that joint, does so.
    Joints that turn without end have no limits here, so that angles may go beyond those of one turn.

    Args:
        robot: The arm.
        start: Where it begins, in [rad].
        positions: Flange positions in the base frame, in [m], near each other.
        rotations: Flange orientations in the base frame (columns: its axes).
        free_roll: Whether only the approach direction counts, not the roll about it.

    Returns:
        Configurations, in [rad]; whether there is one, as `Found`; and how often joints were turned back by then.
    """
    joints, n = np.zeros((len(positions), len(start))), len(positions)
    found, turned = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    _follow(
        Chain(joint_frames(robot), *robot.stops),
        np.array(start, dtype=np.float64), np.ascontiguousarray(positions, dtype=np.float64),
        np.ascontiguousarray(rotations, dtype=np.float64), free_roll, joints, found, turned,
    )  # fmt: skip
    return joints, found, turned


@lru_cache
def _starts(robot: RobotDescription) -> Float[np.ndarray, "starts dof"]:
    return starting_configurations(robot, STARTS, seed=0)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _follow(chain, start, positions, rotations, free_roll, joints, found, turned):
    frames, lower, upper = chain
    n = len(start)
    work = np.empty((4 * n + 16, 6))
    q, least, most, trial = start.copy(), np.empty(n), np.empty(n), np.empty(n)
    missed, turns, how = 0, 0, Descent(free_roll, LEVER, np.int64(ITERATIONS), PRECISION, PRECISION)
    for i in range(len(positions)):
        far = min(FARTHEST * (missed + 1), FARTHEST_AFTER)
        reached = False
        for limited in (True, False):
            possible = True
            for j in range(n):
                least[j] = max(lower[j], q[j] - far) if limited else q[j] - far
                most[j] = min(upper[j], q[j] + far) if limited else q[j] + far
                possible &= least[j] <= most[j]
                trial[j] = min(max(q[j], least[j]), most[j])
            if not possible:
                continue
            off, angle = descend(Chain(frames, least, most), trial, positions[i], rotations[i], how, work)
            reached = off <= POSITION_TOLERANCE and angle <= ANGLE_TOLERANCE
            if reached:
                break
        if reached:
            q[:] = trial
            missed = 0
            turns += _turn_back(q, lower, upper)
            found[i] = 2 if _is_within(q, lower, upper) else 1
        else:
            missed += 1
        joints[i], turned[i] = q, turns


@numba.njit(cache=True, nogil=True)
@no_type_check
def _turn_back(q, lower, upper):
    """Bring joints that are beyond their limits back by a whole turn, if all of them go; returns how many went."""
    turns = 0
    for j in range(len(q)):
        if q[j] > upper[j] and q[j] - 2 * np.pi >= lower[j] or q[j] < lower[j] and q[j] + 2 * np.pi <= upper[j]:
            turns += 1
        elif not lower[j] <= q[j] <= upper[j]:
            return 0
    if turns:
        for j in range(len(q)):
            if q[j] > upper[j]:
                q[j] -= 2 * np.pi
            elif q[j] < lower[j]:
                q[j] += 2 * np.pi
    return turns


@numba.njit(cache=True, nogil=True)
@no_type_check
def _is_within(q, lower, upper):
    for j in range(len(q)):
        if not lower[j] <= q[j] <= upper[j]:
            return False
    return True
