"""Where on the table an arm can hold its tool upright in its branch, and what keeps it from elsewhere."""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt

from envs.arm.arms import HEIGHT, POSTURES, ArmSetting, make_kinematics
from richmap.motion.collision import self_collision
from richmap.robots.robots import load_robot

FIRST_RADIUS = 0.3
"""Distance from the base axis, in [m], at which the search begins: every arm holds its tool upright there, in each of
its branches."""
POSITION_TOLERANCE, TILT_TOLERANCE = 1e-3, np.radians(1)
"""The tool is held upright over a point when the flange is this near to it, in [m], and tilts no more, in [rad]."""
ITERATIONS = 10
"""Least-squares steps per point, from a solution at nearly the same distance from the base."""
LARGEST_TURN = 0.5
"""Most that a joint may turn away from that solution, in [rad]; it keeps the search from leaping to another branch."""


class Feasibility(IntEnum):
    """Whether the tool can be held upright over a point, or else why not; the first that applies."""

    FEASIBLE = 0
    OUT_OF_REACH = 1
    """No branch of the wrist, within the joint limits or without, brings the flange there."""
    JOINT_LIMIT = 2
    """A joint would have to pass a limit that binds."""
    WRONG_BRANCH = 3
    """The arm reaches it with its wrist the other way round only."""
    SELF_COLLISION = 4
    """Two links would meet, triangle against triangle (`richmap.motion.collision`); the tool is not looked at."""


@dataclass(frozen=True)
class TableFeasibility:
    """The answer on a regular grid of points of the table, all with the flange at `envs.arm.arms.HEIGHT`."""

    setting: ArmSetting
    x: Float[np.ndarray, " nx"]
    """World x of the grid's columns, evenly spaced, in [m]."""
    y: Float[np.ndarray, " ny"]
    """Likewise y."""
    cause: Int[np.ndarray, "nx ny"]
    """`Feasibility` of each point."""

    @property
    def feasible(self) -> Bool[np.ndarray, "nx ny"]:
        """Whether the tool can be held upright over each point."""
        return self.cause == Feasibility.FEASIBLE

    def clearance(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Distance to the feasible set's edge, in [m]: above 0 inside, below 0 outside, interpolated.

        The grid's own border is no edge. Points outside of the grid have the clearance of its nearest point.
        """
        lower, upper = [self.x[0], self.y[0]], [self.x[-1], self.y[-1]]
        return self._clearance(np.clip(points, lower, upper))

    def allows(self, points: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether the tool can be held upright over these points and the command can be there: on the grid."""
        lower, upper = [self.x[0], self.y[0]], [self.x[-1], self.y[-1]]
        return ((points >= lower) & (points <= upper)).all(-1) & (self.clearance(points) > 0)

    @cached_property
    def _clearance(self) -> RegularGridInterpolator:
        feasible, spacing = self.feasible, self.x[1] - self.x[0]
        far = np.full(feasible.shape, np.hypot(*feasible.shape))
        inside = distance_transform_edt(feasible) if not feasible.all() else far
        outside = distance_transform_edt(~feasible) if feasible.any() else far
        # The edge runs half way between neighbours, one of which is feasible.
        distance = np.where(feasible, inside - 0.5, 0.5 - outside) * spacing
        return RegularGridInterpolator((self.x, self.y), distance)


def table_feasibility(setting: ArmSetting, spacing: float, box: Float[np.ndarray, "2 2"]) -> TableFeasibility:
    """`feasibility` on a grid over the table.

    Args:
        setting: The arm.
        spacing: Of the grid, in [m]; it is made a little smaller where the box is no multiple of it.
        box: Lower and upper xy of the grid, in [m] in the world.

    Raises:
        ValueError: If the spacing is not above 0 or exceeds the box.
    """
    size = box[1] - box[0]
    if not 0 < spacing <= size.min():
        raise ValueError(f"spacing must be above 0 and at most {size.min():g} m, the box's shorter side. Got {spacing}")
    x, y = (np.linspace(low, high, 1 + int(np.ceil((high - low) / spacing - 1e-9))) for low, high in box.T)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    return TableFeasibility(setting, x, y, feasibility(setting, points.reshape(-1, 2)).reshape(points.shape[:2]))


def feasibility(setting: ArmSetting, points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    """`Feasibility` of holding the tool upright over points of the table, in [m] in the world, in the setting's branch.

    Every point is solved from the solution of a point at nearly the same distance from the base, outwards and then
    inwards, so that the branch is kept as it is when the arm moves there. So the points should not leave wide rings
    about the base empty. Limits and self-collision count where the setting says so.
    """
    held, joints = _held(setting, points)
    cause = np.where(held, Feasibility.FEASIBLE, Feasibility.OUT_OF_REACH)
    for robot, wrist in POSTURES if not held.all() else ():
        if robot == setting.robot and wrist != setting.wrist:
            turned, _ = _held(replace(setting, wrist=wrist), points)
            cause[turned & ~held] = Feasibility.WRONG_BRANCH
    robot = load_robot(setting.robot)
    if setting.joint_limits:  # Six joints: in its branch a pose has one solution, so it is out of limits or in.
        passed = ((joints < robot.lower) | (joints > robot.upper)).any(1)
        cause[held & passed] = Feasibility.JOINT_LIMIT
        held &= ~passed
    if setting.self_collision:
        cause[np.flatnonzero(held)[self_collision(robot)(joints[held])]] = Feasibility.SELF_COLLISION
    return cause


def _held(
    setting: ArmSetting, points: Float[np.ndarray, "n 2"]
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "n dof"]]:
    """Over which points the branch holds the tool upright if no limit binds, and joint angles there, in [rad].

    From the first posture the points are visited outwards, then inwards.
    """
    kinematics = make_kinematics(replace(setting, joint_limits=False))
    first = kinematics.solve(
        np.array([setting.base[0] + FIRST_RADIUS, setting.base[1], HEIGHT]),
        np.array(POSTURES[setting.robot, setting.wrist]),
        iterations=300,
        max_turn=np.inf,
    ).joints
    offset = points - np.array(setting.base[:2])
    radius, azimuth = np.linalg.norm(offset, axis=1), np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(radius)
    split = np.searchsorted(radius[order], FIRST_RADIUS)
    held, joints = np.zeros(len(points), dtype=bool), np.zeros((len(points), len(first)))
    for way in (order[split:], order[:split][::-1]):
        last, at = first, 0.0
        for point in way:
            # About the base axis and back about the tool's: upright still, and as far from the base as before.
            start = last.copy()
            start[[0, -1]] += azimuth[point] - at
            posture = kinematics.solve(np.array([*points[point], HEIGHT]), start, ITERATIONS, LARGEST_TURN)
            upright = posture.residual <= POSITION_TOLERANCE and posture.tilt <= TILT_TOLERANCE
            if upright and kinematics.wrist(posture.joints) == setting.wrist:
                held[point], joints[point] = True, posture.joints
                last, at = posture.joints, azimuth[point]
    return held, joints
