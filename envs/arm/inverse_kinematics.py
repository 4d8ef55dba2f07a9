"""Joint angles that hold the tool upright over a point of the table, by damped least squares."""

from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import mujoco
import numba
import numpy as np
from jaxtyping import Float

from richmap.motion.inverse_kinematics import Chain, pose_errors, solve_positive
from richmap.motion.kinematics import joint_frames
from richmap.physics.mujoco_model import kinematic_spec
from richmap.robots.robot import RobotDescription

ITERATIONS = 5
"""Least-squares steps per control step."""
CONVERGED = 1e-6
"""Weighted error at which iteration stops, in [m]."""
FIRST_DAMPING = 1.0
LEAST_DAMPING = 1e-3
"""Damping never falls below this, in [m]; above it the damping is the error itself, so that it fades near the
goal and grows beyond the reach (Sugihara, IEEE Transactions on Robotics 2011)."""
MAX_TURN = 0.314
"""Most that a joint target moves in one control step, in [rad]: the xArm6's 180 degrees per second."""
TOOL_DOWN = np.array([0.0, 0.0, 1.0, 0.0])
"""Orientation of the flange, (w, x, y, z): a half turn about y, so that its z points down and its x to -x."""


@dataclass(frozen=True)
class Posture:
    """Joint angles and how well they do what was asked."""

    joints: Float[np.ndarray, " dof"]
    """In [rad]."""
    residual: float
    """Distance from the flange to the point asked for, in [m]."""
    tilt: float
    """Angle between the tool and the vertical, in [rad]."""


class Upright(NamedTuple):
    """What compiled loops make small (`InverseKinematics`)."""

    rotation: Float[np.ndarray, "3 3"]
    """Orientation of the flange that holds the tool down, in the base frame (columns: its axes)."""
    rolls_freely: bool
    """Whether the tool's tilt alone counts, not its roll."""
    weight: float
    """Of orientation against position, in [m/rad]."""


class InverseKinematics:
    """Solves for joint angles, each time from where the last answer left off, which keeps the branch.

    Minimises |p - p*|^2 + w^2 |r|^2, with p the flange in [m], r its rotation from `TOOL_DOWN` in [rad] and w
    the orientation weight in [m/rad]. At w = 1 an arm that cannot reach gives up position rather than tilt,
    as the original's does: 10 cm beyond the reach tilt it by about one degree. An arm of fewer than six joints cannot
    roll its tool about the vertical as it likes, and a round tool need not be rolled: r then is the tool's tilt alone.

    Args:
        robot: The arm.
        base: Position of its base in the world, in [m].
        yaw: Turn of its base about the world's z axis, in [rad].
        orientation_weight: w, in [m/rad].
        lower: Least joint angles that may be used, in [rad]; minus infinity where any may.
        upper: Greatest, likewise.
    """

    def __init__(
        self,
        robot: RobotDescription,
        base: Float[np.ndarray, "3"],
        yaw: float,
        orientation_weight: float,
        lower: Float[np.ndarray, " dof"],
        upper: Float[np.ndarray, " dof"],
    ) -> None:
        self._model = kinematic_spec(robot).compile()
        self._data = mujoco.MjData(self._model)
        self._flange = self._model.body(robot.end_effector).id
        self._base, self._weight = np.asarray(base, dtype=float), orientation_weight
        self._turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        self._tool_down = TOOL_DOWN.copy()
        if yaw:
            mujoco.mju_mulQuat(self._tool_down, np.array([np.cos(yaw / 2), 0, 0, -np.sin(yaw / 2)]), TOOL_DOWN)
        self._lower, self._upper = lower, upper
        self._rolls_freely = self._model.nv < 6
        self._chain = Chain(joint_frames(robot), lower, upper)
        self._jacobian = np.zeros((6, self._model.nv))
        self._row_weights = np.array([1, 1, 1, *[orientation_weight] * 3])[:, None]
        self._rotation = np.zeros(3)

    def solve(
        self,
        point: Float[np.ndarray, "3"],
        start: Float[np.ndarray, " dof"],
        iterations: int = ITERATIONS,
        max_turn: float = MAX_TURN,
    ) -> Posture:
        """Move from `start`, in [rad], towards holding the flange at `point`, in [m] in the world."""
        lower = np.maximum(self._lower, start - max_turn)
        upper = np.minimum(self._upper, start + max_turn)
        goal = (np.asarray(point) - self._base) @ self._turn
        joints = _clipped(start, lower, upper)
        error, damping, moved = self._error(joints, goal), FIRST_DAMPING, True
        for _ in range(iterations):
            size = float(error @ error)
            if size < CONVERGED**2:
                break
            if moved:
                self._linearise()
            trial = joints + self._step(error, damping * size + LEAST_DAMPING**2, lower - joints, upper - joints)
            missing = self._error(trial, goal)
            moved = missing @ missing < size
            if moved:
                joints, error, damping = trial, missing, damping / 4
            else:
                damping *= 8
        if not moved:
            error = self._error(joints, goal)
        down = -self._data.xmat[self._flange, 8]
        return Posture(joints, float(np.sqrt(error[:3] @ error[:3])), float(np.arccos(min(max(down, -1.0), 1.0))))

    def follow(
        self, joints: Float[np.ndarray, "n dof"], points: Float[np.ndarray, "n t 3"]
    ) -> Float[np.ndarray, "n t dof"]:
        """Joint angles, in [rad], to which `solve` gets from point to point, in [m] in the world; in compiled loops."""
        goals = (points - self._base) @ self._turn
        down = self._turn.T @ np.diag([-1.0, 1.0, -1.0])
        reached = np.empty((*points.shape[:2], joints.shape[1]))
        _follow(self._chain, joints, goals, Upright(down, self._rolls_freely, self._weight), reached)
        return reached

    def flange(self, joints: Float[np.ndarray, " dof"]) -> Float[np.ndarray, "3"]:
        """Where the flange is, in [m] in the world."""
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        return self._turn @ self._data.xpos[self._flange] + self._base

    def _error(self, joints: Float[np.ndarray, " dof"], goal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "6"]:
        """What is missing: position and weighted rotation vector, base frame."""
        data = self._data
        data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, data)
        if self._rolls_freely:
            return np.concatenate([goal - data.xpos[self._flange], self._weight * _tilt(data.xmat[self._flange, 2::3])])
        mujoco.mju_subQuat(self._rotation, self._tool_down, data.xquat[self._flange])
        turned = data.xmat[self._flange].reshape(3, 3) @ self._rotation
        return np.concatenate([goal - data.xpos[self._flange], self._weight * turned])

    def _linearise(self) -> None:
        """Jacobian of the flange where `_error` was last asked."""
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jacBody(self._model, self._data, self._jacobian[:3], self._jacobian[3:], self._flange)
        if self._rolls_freely:
            approach = self._data.xmat[self._flange, 2::3]
            self._jacobian[3:] -= np.outer(approach, approach @ self._jacobian[3:])

    def _step(
        self,
        error: Float[np.ndarray, "6"],
        damping: float,
        least: Float[np.ndarray, " dof"],
        most: Float[np.ndarray, " dof"],
    ) -> Float[np.ndarray, " dof"]:
        """Damped least-squares step within bounds; the other joints take over what bounded ones leave."""
        jacobian = self._jacobian * self._row_weights
        free = _damped_least_squares(jacobian, error, damping)
        step = _clipped(free, least, most)
        held = step != free
        if held.any():
            rest = error - jacobian[:, held] @ step[held]
            jacobian[:, held] = 0
            step = np.where(held, step, _clipped(_damped_least_squares(jacobian, rest, damping), least, most))
        return step


def _tilt(approach: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The shortest rotation vector, in [rad], that takes a direction, of unit length, straight down."""
    x, y, z = approach
    sine = np.hypot(x, y)
    across = np.array([-y, x, 0.0]) / sine if sine > 1e-9 else np.array([1.0, 0.0, 0.0])  # any, if it points up
    return np.arctan2(sine, -z) * across


def _clipped(
    values: Float[np.ndarray, " n"], least: Float[np.ndarray, " n"], most: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """`np.clip`, in half its time."""
    return np.minimum(np.maximum(values, least), most)


def _damped_least_squares(
    jacobian: Float[np.ndarray, "6 dof"], error: Float[np.ndarray, "6"], damping: float
) -> Float[np.ndarray, " dof"]:
    normal = jacobian @ jacobian.T
    normal.flat[::7] += damping
    return jacobian.T @ np.linalg.solve(normal, error)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _follow(chain, joints, goals, how, reached):
    """Write what `InverseKinematics.solve` gives for each of the goals, each from the answer to the last one."""
    n = joints.shape[1]
    work = np.empty((2 * n + 8, 6))
    least, most = np.empty(n), np.empty(n)
    for i in range(len(joints)):
        q = joints[i]
        for k in range(goals.shape[1]):
            for j in range(n):
                least[j] = max(chain.lower[j], q[j] - MAX_TURN)
                most[j] = min(chain.upper[j], q[j] + MAX_TURN)
                reached[i, k, j] = min(max(q[j], least[j]), most[j])
            q = reached[i, k]
            _approach(Chain(chain.frames, least, most), q, goals[i, k], how, work)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _approach(chain, q, goal, how, work):
    """Move joint angles, in place, towards holding the flange at a goal in the base frame."""
    n = len(q)
    jacobian, tried, normal = work[:n], work[n : 2 * n], work[2 * n : 2 * n + 6]
    error, missing = work[2 * n + 6], work[2 * n + 7]
    step, trial = np.empty(n), np.empty(n)
    pose_errors(chain.frames, q, goal, how.rotation, how.rolls_freely, how.weight, jacobian, error)
    damping = FIRST_DAMPING
    for _ in range(ITERATIONS):
        size = (error * error).sum()
        if size < CONVERGED**2:
            break
        room = chain.lower - q, chain.upper - q
        _bounded_step(jacobian, error, damping * size + LEAST_DAMPING**2, room, step, normal)
        trial[:] = q + step
        pose_errors(chain.frames, trial, goal, how.rotation, how.rolls_freely, how.weight, tried, missing)
        if (missing * missing).sum() < size:
            q[:] = trial
            jacobian, tried = tried, jacobian
            error, missing = missing, error
            damping /= 4
        else:
            damping *= 8


@numba.njit(cache=True, nogil=True)
@no_type_check
def _bounded_step(jacobian, error, damping, bounds, step, normal):
    """Write the damped least-squares step within bounds; the other joints take over what bounded ones leave."""
    least, most = bounds
    held, rest, y = np.zeros(len(step), dtype=np.bool_), error.copy(), np.empty(6)
    for _ in range(2):
        normal[:] = 0.0
        for r in range(6):
            normal[r, r] = damping
        for j in range(len(step)):
            if not held[j]:
                for r in range(6):
                    for c in range(r + 1):
                        normal[r, c] += jacobian[j, r] * jacobian[j, c]
        solve_positive(normal, rest, y)
        bounded = False
        for j in range(len(step)):
            if not held[j]:
                free = (jacobian[j] * y).sum()
                step[j] = min(max(free, least[j]), most[j])
                if step[j] != free:
                    held[j], bounded = True, True
                    rest -= jacobian[j] * step[j]
        if not bounded:
            break
