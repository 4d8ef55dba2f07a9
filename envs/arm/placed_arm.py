"""An arm that stands somewhere and holds its tool in one branch: what a task's environment, fields and rows are of."""

import hashlib
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from envs.arm.inverse_kinematics import InverseKinematics
from richmap.physics.convex_parts import parts_fingerprint
from richmap.robots.robot import RobotDescription

ORIENTATION_WEIGHT = 1.0
"""Weight of orientation against position in the inverse kinematics, in [m/rad], the same for all arms.

In the original the tool stays upright and its tip lags (tilt below 1 degree on a UR3 beyond its reach); this
weight does the same.
"""

FOUND = "found"
"""What a branch is called that no file states."""


@dataclass(frozen=True)
class PlacedArm:
    """Everything about an arm that moves a score. Made once (`envs.arm.place_arm`), handed on as a value."""

    description: RobotDescription
    setting: str
    """`original`: what swapping the arm in the original task does. `embodied`: what a real arm would do. `best`: what
    it would do where it stands best."""
    base: tuple[float, float, float]
    """Position of its base in the world, in [m]; the xArm6 of the original stands at the origin."""
    yaw: float
    """Turn of its base about the world's z axis, in [rad]."""
    posture: tuple[float, ...]
    """Joint angles that name the branch, in [rad]: inverse kinematics begins there. Stated by the arm's file, and then
    in front of it with joint 1 about zero, or found at the task's start."""
    branch: str
    """What the arm's file calls it, or `found`."""
    bounds: tuple[tuple[str, float, float], ...]
    """Joints that the branch keeps to a range: name, least and greatest angle in [rad]."""
    self_collision: bool
    """Whether links collide with each other."""
    joint_limits: bool
    """Whether joints stop at their limits."""
    orientation_weight: float = ORIENTATION_WEIGHT
    """In [m/rad]."""

    @property
    def robot(self) -> str:
        """Its name."""
        return self.description.name

    @property
    def robot_fingerprint(self) -> str:
        """SHA-256 over the description and the convex parts that collide."""
        both = self.description.fingerprint + parts_fingerprint(self.description)
        return hashlib.sha256(both.encode()).hexdigest()

    def numbers(self) -> dict[str, Any]:
        """All of it as plain values, the description as its fingerprint: what caches are keyed by."""
        told = {each.name: getattr(self, each.name) for each in fields(self)}
        return told | {"description": self.robot_fingerprint}

    def limits(self) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
        """Least and greatest joint angles that may be used, in [rad]: the limits where they bind, and the bounds."""
        robot = self.description
        unlimited = np.full(len(robot.joints), np.inf)
        lower, upper = (robot.lower.copy(), robot.upper.copy()) if self.joint_limits else (-unlimited, unlimited)
        for name, least, most in self.bounds:
            joint = robot.joints.index(name)
            lower[joint], upper[joint] = max(lower[joint], least), min(upper[joint], most)
        return lower, upper

    def from_base(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Points of the world, xy in [m], as its base sees them."""
        offset = points - np.array(self.base[:2])
        if self.yaw == 0:
            return offset
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return offset @ np.array([[c, -s], [s, c]])

    def kinematics(self) -> InverseKinematics:
        """Inverse kinematics within its `limits`."""
        base = np.array(self.base)
        return InverseKinematics(self.description, base, self.yaw, self.orientation_weight, *self.limits())


def start_posture(
    arm: PlacedArm, kinematics: InverseKinematics, start: tuple[float, float, float]
) -> Float[np.ndarray, " dof"]:
    """Joint angles with the tool upright over the task's start, in [m] in the world, in the arm's branch, in [rad].

    Raises:
        ValueError: If the arm cannot hold its tool there in that branch.
    """
    point, seed = np.array(start), np.array(arm.posture)
    if arm.branch != FOUND:
        x, y = arm.from_base(point[:2])
        seed[0] += np.arctan2(y, x)
    posture = kinematics.solve(point, seed, iterations=300, max_turn=np.inf)
    if posture.residual > 1e-4:
        raise ValueError(
            f"{arm.robot} with its base at {arm.base} m, in branch {arm.branch}, cannot hold the tool upright over the "
            f"start {start[:2]} m: it stays {1000 * posture.residual:.0f} mm away. Choose another base or branch."
        )
    return posture.joints
