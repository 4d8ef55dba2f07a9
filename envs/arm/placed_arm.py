"""An arm that stands somewhere and holds its tool in one branch: what a task's environment, fields and rows are of."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import batched
from typing import Any

import numpy as np
from jaxtyping import Float

from envs.arm.inverse_kinematics import InverseKinematics
from envs.arm.task_poses import FOUND
from richmap.motion.kinematics import way_about_z
from richmap.physics.convex_parts import parts_fingerprint
from richmap.robots.robot import RobotDescription

ORIENTATION_WEIGHT = 1.0
"""Weight of orientation against position in the inverse kinematics, in [m/rad], the same for all arms.

In the original the tool stays upright and its tip lags (tilt below 1 degree on a UR3 beyond its reach); this
weight does the same.
"""

TOOL_LENGTH = 0.04
"""Of the usual tool, from the flange down, in [m]: whatever names a pose of the flange means one that carries it."""


def rounded_posture(angles: Iterable[float]) -> tuple[float, ...]:
    """Joint angles to a millionth, in [rad]: the last bits of one that was found differ from processor to processor."""
    return tuple(round(float(angle), 6) for angle in angles)


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
    narrowed: tuple[float, ...] = ()
    """Joints whose limits are narrower than the description's: number from 1 on, least and greatest angle in [rad], for
    each of them one after another."""
    tool_length: float = TOOL_LENGTH
    """From the flange down, in [m]. The tool's end is where it is with the usual tool, so that the flange is held as
    much higher as the tool is longer: to kinematics the base stands as much lower (`kinematic_base`)."""
    delay: float = 0.0
    """How late a command comes to the arm, in [s]."""
    obstacles: int = 0
    """Cuboids on and over the table that it is not to touch (`envs.arm.obstacles`); where, the scene says."""

    @property
    def robot(self) -> str:
        """Its name."""
        return self.description.name

    @property
    def stored_posture(self) -> tuple[float, ...]:
        """Its posture as files have it, in [rad]."""
        return rounded_posture(self.posture)

    @property
    def protected(self) -> bool:
        """Whether a controller stops it when it touches itself or the table, and keeps its command near: not in the
        setting `original`."""
        return self.setting != "original"

    @property
    def robot_fingerprint(self) -> str:
        """SHA-256 over the description and the convex parts that collide."""
        both = self.description.fingerprint + parts_fingerprint(self.description)
        return hashlib.sha256(both.encode()).hexdigest()

    def numbers(self) -> dict[str, Any]:
        """All of the arm itself, without obstacles, as plain values, the description as its fingerprint: what caches
        are keyed by."""
        told = {each.name: getattr(self, each.name) for each in fields(self) if each.name != "obstacles"}
        return told | {"description": self.robot_fingerprint}

    @property
    def kinematic_base(self) -> tuple[float, float, float]:
        """Where the base would stand, in [m], if the arm with the usual tool held that as it holds its own."""
        x, y, z = self.base
        return x, y, z - (self.tool_length - TOOL_LENGTH)

    @cached_property
    def joint_range(self) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
        """Its joint limits, lower and upper, in [rad]: the description's, or narrower ones."""
        lower, upper = self.description.lower.copy(), self.description.upper.copy()
        for number, least, most in batched(self.narrowed, 3):
            joint = int(number) - 1
            lower[joint], upper[joint] = max(lower[joint], least), min(upper[joint], most)
        return lower, upper

    def as_mapped(self) -> tuple[RobotDescription, tuple[float, float, float]]:
        """The description whose reachability map is this arm's, with its limits and its turn, and where it stands."""
        robot = self.description.narrowed(*self.joint_range) if self.narrowed else self.description
        return robot.turned(self.yaw), self.kinematic_base

    def as_mapped_in_branch(self) -> tuple[RobotDescription, tuple[float, float, float]]:
        """The same for the map of its branch alone."""
        robot, base = self.as_mapped()
        return robot.in_branch_of(self.stored_posture), base

    def limits(self) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
        """Least and greatest joint angles that may be used, in [rad]: the limits where they bind, and the bounds."""
        robot = self.description
        unlimited = np.full(len(robot.joints), np.inf)
        lower, upper = (x.copy() for x in (self.joint_range if self.joint_limits else (-unlimited, unlimited)))
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
        """Inverse kinematics within its `limits`, of the flange as it would carry the usual tool."""
        base = np.array(self.kinematic_base)
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
        way, centre = way_about_z(arm.description)
        x, y = arm.from_base(point[:2]) - centre
        seed[0] += way * np.arctan2(y, x)
    posture = kinematics.solve(point, seed, iterations=300, max_turn=np.inf)
    if posture.residual > 1e-4:
        raise ValueError(
            f"{arm.robot} with its base at {arm.base} m, in branch {arm.branch}, cannot hold the tool upright over the "
            f"start {start[:2]} m: it stays {1000 * posture.residual:.0f} mm away. Choose another base or branch."
        )
    return posture.joints
