"""Settings that say which arm acts, where it stands and what it may do."""

import math
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TYPE_CHECKING

from benchmark.settings.setting import SettingError, check_choice, check_setting
from richmap.robots import ROBOTS, SOURCE

if TYPE_CHECKING:
    from richmap.robots.robot import RobotDescription

SOURCE_IN_WORDS = "xArm6"
"""The same arm in a sentence."""

PAPER_ARMS = (SOURCE, "ur3", "ur5", "ur10")
"""The source and the arms that the paper transfers to: what lists of arms hold unless told otherwise."""


@dataclass(unsafe_hash=True)
class RobotConfig:
    """Which arm."""

    name: str = "xarm6"
    """One of the arms that are known, or custom."""
    path: str = ""
    """With robot=custom: URDF, xacro or MJCF (.xml) file of the arm."""
    base: str = ""
    """With robot=custom: the link or body that is fixed to the world; its frame is the base frame."""
    end_effector: str = ""
    """With robot=custom: the link, body or site that carries the tool."""
    approach: str = "z"
    """With robot=custom: the axis of the end effector that is the approach direction: x, y, z, -x, -y or -z."""
    srdf: str = ""
    """With robot=custom: SRDF file that says which pairs of links never touch; empty for none."""
    ignore: list[list[str]] = field(default_factory=list, hash=False)
    """With robot=custom: further pairs of links that are not checked for collision, as in [[base,hand],[base,arm]]."""
    arguments: str = ""
    """With robot=custom: arguments of a xacro file, as in robot.arguments="name:=ur5e prefix:=a_"; empty for none."""

    def __post_init__(self) -> None:
        needed = ("path", "base", "end_effector")
        for name in (*needed, "approach", "srdf", "ignore", "arguments"):
            value, custom = getattr(self, name), self.name == "custom"
            if value == "z":
                continue
            if custom and not value and name in needed:
                raise SettingError(
                    f"robot=custom needs robot.{name}. Give all of: robot=custom robot.path=robot.urdf "
                    "robot.base=<link> robot.end_effector=<link>."
                )
            if value and not custom:
                raise SettingError(f"robot.{name}={value} goes with robot=custom. Here robot={self.name}.")

    def load(self) -> "RobotDescription":
        """Description of the arm; what is worth knowing of one that does not ship is printed.

        Raises:
            SettingError: If a custom arm lacks something.
        """
        from richmap.robots.custom import custom_robot
        from richmap.robots.robots import load_robot

        if self.name != "custom":
            return load_robot(self.name)
        try:
            robot = custom_robot(
                self.path, self.base, self.end_effector, self.approach, self.srdf or None, self.ignore, self.arguments
            )
        except ValueError as error:
            raise SettingError(f"robot=custom: {error}") from error
        _introduce(robot)
        return robot


@cache
def _introduce(robot: "RobotDescription") -> None:
    """Say once what was left out of an arm's file, or taken for granted."""
    from richmap.motion.remarks import remarks

    print(f"{robot.name}:", *remarks(robot), sep="\n  ")


def robot_field(default: str, choices: tuple[str, ...] = (*ROBOTS, "custom")) -> RobotConfig:
    """The field of a schema that picks an arm."""
    return field(default_factory=partial(RobotConfig, default), metadata={"choices": choices})


MOST_TURNED = 100
"""Of a joint's angle, in [rad]."""


@dataclass
class ArmConfig:
    """Single choices of an arm's setting, where they are not to be the setting's."""

    base: list[float] | None = None
    """Position of the arm's base in the world (the xArm6's base frame), [x,y,z] in m; null for the setting's."""
    yaw: float | None = None
    """Turn of the arm's base about the vertical, in rad, from -pi to pi; null for the setting's."""
    branch: str | None = None
    """Way of holding the tool: one that the arm's file names (a UR's wrist_out or wrist_in), or found (the best that is
    found); null for the setting's."""
    posture: list[float] | None = None
    """With the branch found: joint angles over the task's start that name it, in rad, instead of seeking them; null to
    seek them."""
    self_collision: bool | None = None
    """Whether links collide with each other, true or false; null for the setting's."""
    orientation_weight: float | None = None
    """Weight of orientation against position in the inverse kinematics, in m/rad, above 0; null for the default."""
    narrowed: list[float] = field(default_factory=list)
    """Joints whose limits are narrower than the arm's: number from 1 on, least and greatest angle in rad, one after
    another, as in arm.narrowed=[1,-1.05,1.05]; empty for none."""
    tool_length: float = 0.04
    """Of the tool, from the flange down, in m, from 0.02 to 0.3; its end is always held at the same height."""
    delay: float = 0.0
    """How late commands come to the arm, in s, from 0 to 1; a whole number of control steps of 0.1 s."""
    obstacles: int = 0
    """Cuboids on and over the table that the arm is not to touch, from 0 to 8; the scene's seed says where."""

    def __post_init__(self) -> None:
        base, weight = self.base, self.orientation_weight
        check_setting(0.02 <= self.tool_length <= 0.3, "arm.tool_length", self.tool_length, "a number from 0.02 to 0.3")
        steps = 10 * self.delay
        whole = 0 <= self.delay <= 1 and abs(steps - round(steps)) < 1e-9
        check_setting(whole, "arm.delay", self.delay, "tenths of a second from 0 to 1")
        if self.posture is not None:
            turned = all(abs(angle) <= MOST_TURNED for angle in self.posture)
            check_setting(turned, "arm.posture", self.posture, f"angles in rad from -{MOST_TURNED} to {MOST_TURNED}")
        if base is not None:
            near = len(base) == 3 and all(abs(x) <= 1 for x in base)
            check_setting(near, "arm.base", base, "[x,y,z] in m, each from -1 to 1")
        near = self.yaw is None or abs(self.yaw) <= math.pi
        check_setting(near, "arm.yaw", self.yaw, "a number from -pi to pi")
        if weight is not None:
            check_setting(0 < weight < math.inf, "arm.orientation_weight", weight, "a number above 0")


def check_targets(robots: list[str]) -> None:
    """Raise `SettingError` unless these are arms that a policy can be transferred to, one or more."""
    targets = [name for name in ROBOTS if name != SOURCE]
    for name in robots or ["[]"]:
        check_choice("robots", name, targets)


def in_tables(robot: str) -> int:
    """Where an arm comes in tables: the paper's first, then others that ship, then those that do not."""
    order = [*PAPER_ARMS, *(name for name in ROBOTS if name not in PAPER_ARMS)]
    return order.index(robot) if robot in order else len(order)
