"""What an arm may do in this task: where it stands, how it holds its wrist, what stops it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from envs.arm.inverse_kinematics import InverseKinematics
from richmap.robots.robots import load_robot
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

ARMS = ("xarm6", "ur3", "ur5", "ur10")
"""The arms that do this task."""

HEIGHT = BLOCK_PUSH_SPACE.steps.position[2]
"""Of the flange above the table, in [m]."""
ORIENTATION_WEIGHT = 1.0
"""Weight of orientation against position in the inverse kinematics, in [m/rad], the same for all arms.

In the original the tool stays upright and its tip lags (tilt below 1 degree on a UR3 beyond its reach); this
weight does the same.
"""


@dataclass(frozen=True)
class ArmSetting:
    """Everything about an arm that moves a score and is not its description."""

    robot: str
    name: str
    """`original`: what swapping the arm in the original task does. `embodied`: what a real arm would do. `best`: what
    it would do where it stands best."""
    base: tuple[float, float, float]
    """Position of the arm's base, in [m]; the xArm6 of the original stands at the origin."""
    wrist: str
    """Branch of the wrist: the flange hangs outside it (`out`, a UR's usual home) or inside (`in`)."""
    self_collision: bool
    """Whether links collide with each other."""
    joint_limits: bool
    """Whether joints stop at their limits."""
    orientation_weight: float = ORIENTATION_WEIGHT
    """In [m/rad]."""


COMMON_BASE = (0.0, 0.0, 0.0)

BEST_PLACES = {
    "xarm6": (COMMON_BASE, "out"),
    "ur3": ((0.06, -0.12, 0.0), "out"),
    "ur5": ((0.12, -0.2, 0.0), "in"),
    "ur10": ((-0.02, 0.0, 0.0), "in"),
}
"""Base, in [m], and wrist as `python -m benchmark.studies.place_bases` finds them; the source stays where it was
trained."""

SETTINGS = {
    "original": {
        robot: ArmSetting(robot, "original", COMMON_BASE, "out", self_collision=False, joint_limits=False)
        for robot in ARMS
    },
    "embodied": {  # A UR3 cannot reach the start with its wrist in; UR5 and UR10 fold less with it in.
        robot: ArmSetting(robot, "embodied", COMMON_BASE, wrist, self_collision=True, joint_limits=True)
        for robot, wrist in {"xarm6": "out", "ur3": "out", "ur5": "in", "ur10": "in"}.items()
    },
    "best": {
        robot: ArmSetting(robot, "best", base, wrist, self_collision=True, joint_limits=True)
        for robot, (base, wrist) in BEST_PLACES.items()
    },
}

_UR_POSTURES = {"out": (-0.2, -1.2, 1.8, -2.2, -1.57, 0.4), "in": (-0.2, -1.2, 1.8, 0.8, 1.57, -2.8)}
POSTURES = {
    ("xarm6", "out"): (0.0, 0.7, -1.1, 0.0, 0.4, -4.1),
    **{(robot, wrist): posture for robot in ("ur3", "ur5", "ur10") for wrist, posture in _UR_POSTURES.items()},
}
"""Roughly how each arm holds its tool upright in front of it, elbow up, at pan zero, in [rad]: it picks the
branch."""


ELBOWS = {"xarm6": (-np.inf, np.inf), **{robot: (0.02, np.inf) for robot in ("ur3", "ur5", "ur10")}}
"""Range of the third joint that keeps the elbow up, in [rad]. A UR's elbow is straight at 0, which it meets
at its outer reach: past that it would come back elbow down, into the table. The xArm6 never gets there."""


def make_kinematics(setting: ArmSetting) -> InverseKinematics:
    """Inverse kinematics that keeps the elbow up and, where they bind, the joint limits."""
    robot = load_robot(setting.robot)
    unlimited = np.full(len(robot.joints), np.inf)
    lower, upper = (robot.lower.copy(), robot.upper.copy()) if setting.joint_limits else (-unlimited, unlimited)
    straight, folded = ELBOWS[setting.robot]
    lower[2], upper[2] = max(lower[2], straight), min(upper[2], folded)
    return InverseKinematics(robot, np.array(setting.base), setting.orientation_weight, lower, upper)


def arm_setting(
    robot: str,
    setting: str = "embodied",
    base: Sequence[float] | None = None,
    wrist: str | None = None,
    self_collision: bool | None = None,
    orientation_weight: float | None = None,
) -> ArmSetting:
    """A setting by name, with single choices replaced where given.

    Raises:
        ValueError: If there is no such robot or setting, or the arm cannot do the task in that branch.
    """
    if setting not in SETTINGS:
        raise ValueError(f"There is no setting {setting!r}. Settings: {', '.join(SETTINGS)}")
    if robot not in SETTINGS[setting]:
        raise ValueError(f"There is no robot {robot!r}. Robots: {', '.join(SETTINGS[setting])}")
    if base is not None and len(base) != 3:
        raise ValueError(f"base is x, y, z in metres. Got {len(base)} numbers: {tuple(base)}")
    given = {
        "base": None if base is None else tuple(map(float, base)),
        "wrist": wrist,
        "self_collision": self_collision,
        "orientation_weight": orientation_weight,
    }
    chosen = replace(SETTINGS[setting][robot], **{key: value for key, value in given.items() if value is not None})
    if not chosen.orientation_weight > 0:
        raise ValueError(f"orientation_weight must be above 0 m/rad. Got {chosen.orientation_weight}")
    if (robot, chosen.wrist) not in POSTURES:
        allowed = ", ".join(w for r, w in POSTURES if r == robot)
        raise ValueError(f"{robot} has no wrist branch {chosen.wrist!r}. Branches: {allowed}")
    return chosen


def start_posture(
    kinematics: InverseKinematics, setting: ArmSetting, start: tuple[float, float]
) -> Float[np.ndarray, " dof"]:
    """Joint angles over the task's start, xy in [m], in [rad], in the branch that the setting names.

    Raises:
        ValueError: If the arm cannot hold its tool there in that branch.
    """
    point = np.array([*start, HEIGHT])
    seed = np.array(POSTURES[setting.robot, setting.wrist])
    seed[0] += np.arctan2(start[1] - setting.base[1], start[0] - setting.base[0])
    posture = kinematics.solve(point, seed, iterations=300, max_turn=np.inf)
    if posture.residual > 1e-4 or kinematics.wrist(posture.joints) != setting.wrist:
        raise ValueError(
            f"{setting.robot} with its base at {setting.base} m and its wrist {setting.wrist} cannot hold "
            f"the tool upright over the start {start} m: it stays {1000 * posture.residual:.0f} mm away. "
            f"Choose another base or wrist."
        )
    return posture.joints
