"""Inverse kinematics of any serial arm: damped least squares within joint limits, from many starts, in compiled loops.

A pose is asked for whole (6-D), or with its roll about the approach direction left free (5-D), as a map of directions
answers it.
"""

from functools import lru_cache
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float

from richmap.motion.collision import self_collision
from richmap.motion.kinematics import joint_frames
from richmap.motion.reach import beyond_reach, wrist_offset
from richmap.robots.robot import RobotDescription

POSITION_TOLERANCE, ANGLE_TOLERANCE = 1e-3, 1e-2
"""A configuration reaches a pose if its flange is within so many [m] and [rad] of it."""

ITERATIONS = 40
"""Steps that a start is given at most; most end sooner."""

LEVER = 0.2
"""Weight of the angle error against the position error in a descent, in [m/rad]."""

STEP = 1.5
"""Longest step of a joint, in [rad]."""

SAME = 0.02
"""Configurations that differ by less, in [rad], are checked for self-collision once."""

MOST_FOUND = (1, 8, 1 << 30)
"""Configurations per pose that are collected before they are checked: most poses need one, and a check of many at
once costs less than many checks."""


class Chain(NamedTuple):
    """What compiled loops read of an arm."""

    frames: Float[np.ndarray, "dof1 3 4"]
    """Its joint frames (`kinematics.joint_frames`)."""
    lower: Float[np.ndarray, " dof"]
    """Least joint angles, in [rad]."""
    upper: Float[np.ndarray, " dof"]
    """Greatest joint angles, in [rad]."""


class Descent(NamedTuple):
    """How far a descent goes, and what it makes small."""

    free_roll: bool
    """Whether only the approach direction counts, not the roll about it."""
    lever: float
    """Weight of the angle error against the position error, in [m/rad]."""
    iterations: int
    """Most steps."""
    off_enough: float
    """Error of position that ends it, in [m]."""
    angle_enough: float
    """Error of angle that ends it, in [rad]."""


def starting_configurations(robot: RobotDescription, n: int, seed: int) -> Float[np.ndarray, "n dof"]:
    """A scrambled Sobol sequence over the joint limits, in [rad]: its first starts are spread as evenly as all."""
    from scipy.stats import qmc  # Takes half a second to load, and most processes need no start.

    sobol = qmc.Sobol(len(robot.joints), rng=np.random.default_rng(seed))
    unit = sobol.random_base2(int(np.ceil(np.log2(n))))[:n]
    return robot.lower + unit * (robot.upper - robot.lower)


def refine(
    robot: RobotDescription,
    joints: Float[np.ndarray, "n dof"],
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"],
    iterations: int = ITERATIONS,
    free_roll: bool = False,
) -> tuple[Float[np.ndarray, "n dof"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Descend from one configuration per pose towards that pose, until it is within the strict tolerance.

    Args:
        robot: The arm.
        joints: Configurations to start from, in [rad].
        positions: Flange positions in the base frame, in [m].
        rotations: Flange orientations in the base frame (columns: its axes).
        iterations: Most steps to take.
        free_roll: Whether only the approach direction counts, not the roll about it.

    Returns:
        Configurations, in [rad], and the errors that are left: of position in [m] and of orientation in [rad].
    """
    joints = np.array(joints, dtype=np.float64)
    errors = np.empty((len(joints), 2))
    _refine(_chain(robot), joints, *_as_float64(positions, rotations), iterations, free_roll, errors)
    return joints, errors[:, 0], errors[:, 1]


def solve(
    robot: RobotDescription,
    starts: Float[np.ndarray, "starts dof"],
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"],
    free_roll: bool = False,
    loose: float = 0.0,
) -> tuple[Float[np.ndarray, "n dof"], Bool[np.ndarray, " n"]]:
    """Descend from start after start until one reaches the pose within the limits and free of self-collision.

    Args:
        robot: The arm.
        starts: Configurations to start from, in [rad]. Each pose begins with the first.
        positions: Flange positions in the base frame, in [m].
        rotations: Flange orientations in the base frame (columns: its axes).
        free_roll: Whether only the approach direction counts, not the roll about it.
        loose: A sum of position error in [mm] and angle error in [deg] that is good enough, as in RM4D; 0 for the
            strict tolerance of `POSITION_TOLERANCE` and `ANGLE_TOLERANCE`.

    Returns:
        Configurations, in [rad], and for which poses there is one; the other rows mean nothing.
    """
    positions, rotations = _as_float64(positions, rotations)
    joints, solved = np.zeros((len(positions), len(robot.joints))), np.zeros(len(positions), dtype=bool)
    next_start = np.zeros(len(positions), dtype=np.int64)
    check, wrist = self_collision(robot), wrist_offset(robot)
    # However the errors are shared out, the wrist is off by no more than this.
    off = max(1e-3, np.radians(wrist)) * loose if loose else POSITION_TOLERANCE + ANGLE_TOLERANCE * wrist
    pending = np.flatnonzero(~beyond_reach(robot, positions, rotations, off))
    for most in MOST_FOUND:
        most = min(most, len(starts))
        found, after = np.full((len(pending), most, len(robot.joints)), np.nan), next_start[pending]
        _search(
            _chain(robot), np.ascontiguousarray(starts), positions[pending], rotations[pending], free_roll, loose,
            found, after,
        )  # fmt: skip
        next_start[pending] = after
        of, which = np.nonzero(~np.isnan(found[:, :, 0]))
        free = ~check(found[of, which])
        joints[pending[of[free]]], solved[pending[of[free]]] = found[of[free], which[free]], True
        pending = pending[~solved[pending] & (after < len(starts))]
    return joints, solved


def configurations(
    robot: RobotDescription,
    starts: Float[np.ndarray, "starts dof"],
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"],
    most: int,
    free_roll: bool = False,
    limited: bool = True,
) -> Float[np.ndarray, "n most dof"]:
    """Different configurations that reach each pose, in the order in which they are found, self-collision or not.

    Args:
        robot: The arm.
        starts: Configurations to start from, in [rad]; all are used unless `most` are found.
        positions: Flange positions in the base frame, in [m].
        rotations: Flange orientations in the base frame (columns: its axes).
        most: Configurations to find at most. Whole turns of a joint make no other one.
        free_roll: Whether only the approach direction counts, not the roll about it.
        limited: Whether they are to be within the joint limits.

    Returns:
        Configurations, in [rad]; rows of NaN where there is no further one.
    """
    positions, rotations = _as_float64(positions, rotations)
    found = np.full((len(positions), most, len(robot.joints)), np.nan)
    chain, dof = _chain(robot), len(robot.joints)
    if not limited:
        chain = chain._replace(lower=np.full(dof, -2 * np.pi), upper=np.full(dof, 2 * np.pi))
    pending = np.flatnonzero(
        ~beyond_reach(robot, positions, rotations, POSITION_TOLERANCE + ANGLE_TOLERANCE * wrist_offset(robot))
    )
    of_pending, begin = found[pending], np.zeros(len(pending), dtype=np.int64)
    starts = np.ascontiguousarray(starts, dtype=np.float64)
    _search(chain, starts, positions[pending], rotations[pending], free_roll, 0.0, of_pending, begin)
    found[pending] = of_pending
    return found


@lru_cache
def _chain(robot: RobotDescription) -> Chain:
    return Chain(joint_frames(robot), robot.lower.astype(np.float64), robot.upper.astype(np.float64))


def _as_float64(positions: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(positions, dtype=np.float64), np.ascontiguousarray(rotations, dtype=np.float64)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _refine(chain, joints, positions, rotations, iterations, free_roll, errors):
    work = np.empty((4 * joints.shape[1] + 16, 6))
    how = Descent(free_roll, LEVER, iterations, POSITION_TOLERANCE, ANGLE_TOLERANCE)
    for i in range(len(joints)):
        errors[i] = descend(chain, joints[i], positions[i], rotations[i], how, work)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _search(chain, starts, positions, rotations, free_roll, loose, found, next_start):
    """Fill the rows of `found` (n, most, dof) with different configurations that reach each pose, as far as they go.

    `next_start` says which start to begin with; it becomes the one after the last that was used.
    """
    work = np.empty((4 * starts.shape[1] + 16, 6))
    q = np.empty(starts.shape[1])
    how = Descent(free_roll, LEVER, np.int64(ITERATIONS), POSITION_TOLERANCE, ANGLE_TOLERANCE)
    for i in range(len(positions)):
        p, r, count = positions[i], rotations[i], 0
        while next_start[i] < len(starts) and count < found.shape[1]:
            q[:] = starts[next_start[i]]
            next_start[i] += 1
            off, angle = descend(chain, q, p, r, how, work)
            reached = off <= POSITION_TOLERANCE and angle <= ANGLE_TOLERANCE
            if loose > 0 and not reached:
                off, angle = _polish(chain, q, p, r, free_roll, loose, (off, angle), work)
                reached = 1e3 * off + np.degrees(angle) <= loose
            if reached and not _is_among(q, found[i, :count]):
                found[i, count] = q
                count += 1


@numba.njit(cache=True, nogil=True)
@no_type_check
def _is_among(q, others):
    """Whether a configuration is one of the others but for whole turns, within `SAME`."""
    for other in others:
        apart = 0.0
        for j in range(len(q)):
            turns = (q[j] - other[j]) / (2 * np.pi)
            apart = max(apart, abs(turns - np.round(turns)))
        if 2 * np.pi * apart < SAME:
            return True
    return False


@numba.njit(cache=True, nogil=True)
@no_type_check
def _polish(chain, q, position, rotation, free_roll, loose, errors, work):
    """Lessen the sum of position error in [mm] and angle error in [deg] where it may become `loose`.

    A sum a + b of lengths is least where a^2 / s + b^2 / (1 - s) is, for s = a / (a + b): squares weighted anew in
    each round.
    """
    off, angle = errors
    steps = np.int64(12)
    for _ in range(4):
        total = 1e3 * off + np.degrees(angle)
        if total <= loose or total > 4 * loose:
            break
        share = min(max(1e3 * off / total, 0.05), 0.95)
        lever = np.degrees(1e-3) * np.sqrt(share / (1 - share))
        how = Descent(free_roll, lever, steps, POSITION_TOLERANCE, ANGLE_TOLERANCE)
        off, angle = descend(chain, q, position, rotation, how, work)
    return off, angle


@numba.njit(cache=True, nogil=True)
@no_type_check
def descend(chain, q, position, rotation, how, work):
    """Levenberg-Marquardt steps on `q`, in place, until the errors of position in [m] and of angle in [rad] are small
    enough; returns them. It takes a `Chain` and a `Descent`.

    Numba compiles it anew for each literal among its arguments: hand on variables.

    Nakamura & Hanafusa (1986), with joints held at a limit that the step would cross left out of it, and the damping
    of Marquardt: less after a step that brings the flange nearer, more after one that does not.
    """
    frames, lower, upper = chain
    free_roll, lever, iterations, off_enough, angle_enough = how
    n = len(q)
    jacobian, tried = work[:n], work[n : 2 * n]
    a = work[2 * n : 2 * n + 6]
    e, e_tried, y, trial = work[2 * n + 6], work[2 * n + 7], work[2 * n + 8], work[3 * n + 10 :].reshape(-1)[:n]
    off, angle = pose_errors(frames, q, position, rotation, free_roll, lever, jacobian, e)
    cost = _square(e)
    damping, slow, refused = min(0.05, cost), 0, 0  # Nearly Newton steps from a start that is near.
    for _ in range(iterations):
        if off <= off_enough and angle <= angle_enough:
            break
        for r in range(6):
            for c in range(r + 1):
                a[r, c] = damping if r == c else 0.0
        for j in range(n):
            row = jacobian[j]
            pull = 0.0
            for r in range(6):
                pull += row[r] * e[r]
            held = (q[j] <= lower[j] and pull < 0) or (q[j] >= upper[j] and pull > 0)
            trial[j] = 0.0 if held else 1.0
            if not held:
                for r in range(6):
                    for c in range(r + 1):
                        a[r, c] += row[r] * row[c]
        solve_positive(a, e, y)
        longest = 0.0
        for j in range(n):
            step = 0.0
            for r in range(6):
                step += jacobian[j, r] * y[r]
            trial[j] *= step
            longest = max(longest, abs(trial[j]))
        scale = min(1.0, STEP / max(longest, 1e-12))
        for j in range(n):
            trial[j] = _within(q[j] + scale * trial[j], lower[j], upper[j])
        off_tried, angle_tried = pose_errors(frames, trial, position, rotation, free_roll, lever, tried, e_tried)
        cost_tried = _square(e_tried)
        if cost_tried < cost:
            slow = slow + 1 if cost_tried > 0.95 * cost else 0
            q[:] = trial
            jacobian, tried = tried, jacobian
            e, e_tried = e_tried, e
            off, angle, cost = off_tried, angle_tried, cost_tried
            damping, refused = max(0.4 * damping, 1e-9), 0
            if slow == 3:
                break
        else:
            damping *= 8
            refused += 1
            if refused == 4:
                break
    return off, angle


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def _square(e):
    return e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + e[3] * e[3] + e[4] * e[4] + e[5] * e[5]


@numba.njit(cache=True, nogil=True)
@no_type_check
def _within(q, lower, upper):
    """The joint value within its limits that is nearest, or the same one after a whole turn."""
    if q > upper:
        return q - 2 * np.pi if q - 2 * np.pi >= lower else upper
    if q < lower:
        return q + 2 * np.pi if q + 2 * np.pi <= upper else lower
    return q


@numba.njit(cache=True, nogil=True)
@no_type_check
def solve_positive(a, b, x):
    """Solve a x = b for a symmetric positive 6 x 6 matrix (its lower triangle, overwritten) by Cholesky's method."""
    for i in range(6):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                a[i, i] = 1.0 / np.sqrt(max(s, 1e-30))
            else:
                a[i, j] = s * a[j, j]
    for i in range(6):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * x[k]
        x[i] = s * a[i, i]
    for i in range(5, -1, -1):
        s = x[i]
        for k in range(i + 1, 6):
            s -= a[k, i] * x[k]
        x[i] = s * a[i, i]


@numba.njit(cache=True, nogil=True)
@no_type_check
def pose_errors(frames, q, position, rotation, free_roll, lever, jacobian, e):
    """Errors of a configuration; writes how the flange moves per joint, and the weighted error, both in [m]."""
    n = len(q)
    px, py, pz = frames[0, 0, 3], frames[0, 1, 3], frames[0, 2, 3]
    r00, r01, r02 = frames[0, 0, 0], frames[0, 0, 1], frames[0, 0, 2]
    r10, r11, r12 = frames[0, 1, 0], frames[0, 1, 1], frames[0, 1, 2]
    r20, r21, r22 = frames[0, 2, 0], frames[0, 2, 1], frames[0, 2, 2]
    for j in range(n):
        row = jacobian[j]
        row[0], row[1], row[2] = px, py, pz
        row[3], row[4], row[5] = r02, r12, r22
        c, s = np.cos(q[j]), np.sin(q[j])
        f = frames[j + 1]
        x0, y0 = c * r00 + s * r01, c * r01 - s * r00
        x1, y1 = c * r10 + s * r11, c * r11 - s * r10
        x2, y2 = c * r20 + s * r21, c * r21 - s * r20
        px += x0 * f[0, 3] + y0 * f[1, 3] + r02 * f[2, 3]
        py += x1 * f[0, 3] + y1 * f[1, 3] + r12 * f[2, 3]
        pz += x2 * f[0, 3] + y2 * f[1, 3] + r22 * f[2, 3]
        z0, z1, z2 = r02, r12, r22
        r00, r01, r02 = (
            x0 * f[0, 0] + y0 * f[1, 0] + z0 * f[2, 0],
            x0 * f[0, 1] + y0 * f[1, 1] + z0 * f[2, 1],
            x0 * f[0, 2] + y0 * f[1, 2] + z0 * f[2, 2],
        )
        r10, r11, r12 = (
            x1 * f[0, 0] + y1 * f[1, 0] + z1 * f[2, 0],
            x1 * f[0, 1] + y1 * f[1, 1] + z1 * f[2, 1],
            x1 * f[0, 2] + y1 * f[1, 2] + z1 * f[2, 2],
        )
        r20, r21, r22 = (
            x2 * f[0, 0] + y2 * f[1, 0] + z2 * f[2, 0],
            x2 * f[0, 1] + y2 * f[1, 1] + z2 * f[2, 1],
            x2 * f[0, 2] + y2 * f[1, 2] + z2 * f[2, 2],
        )
    for j in range(n):
        row = jacobian[j]
        lx, ly, lz = px - row[0], py - row[1], pz - row[2]
        wx, wy, wz = row[3], row[4], row[5]
        row[0], row[1], row[2] = wy * lz - wz * ly, wz * lx - wx * lz, wx * ly - wy * lx
        along = wx * r02 + wy * r12 + wz * r22 if free_roll else 0.0
        row[3], row[4], row[5] = lever * (wx - along * r02), lever * (wy - along * r12), lever * (wz - along * r22)
    e[0], e[1], e[2] = position[0] - px, position[1] - py, position[2] - pz
    t = rotation
    wx, wy, wz = r12 * t[2, 2] - r22 * t[1, 2], r22 * t[0, 2] - r02 * t[2, 2], r02 * t[1, 2] - r12 * t[0, 2]
    cosine = r02 * t[0, 2] + r12 * t[1, 2] + r22 * t[2, 2]
    if not free_roll:
        wx += r10 * t[2, 0] - r20 * t[1, 0] + r11 * t[2, 1] - r21 * t[1, 1]
        wy += r20 * t[0, 0] - r00 * t[2, 0] + r21 * t[0, 1] - r01 * t[2, 1]
        wz += r00 * t[1, 0] - r10 * t[0, 0] + r01 * t[1, 1] - r11 * t[0, 1]
        wx, wy, wz = 0.5 * wx, 0.5 * wy, 0.5 * wz
        cosine += r00 * t[0, 0] + r10 * t[1, 0] + r20 * t[2, 0] + r01 * t[0, 1] + r11 * t[1, 1] + r21 * t[2, 1]
        cosine = 0.5 * (cosine - 1)
    sine = np.sqrt(wx * wx + wy * wy + wz * wz)
    angle = np.arctan2(sine, cosine)
    turn = lever * angle / max(sine, 1e-9)
    e[3], e[4], e[5] = turn * wx, turn * wy, turn * wz
    return np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), angle
