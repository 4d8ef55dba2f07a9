"""Placing an arm: from its description, a setting and what a task asks of it to a `PlacedArm`; the door of arms."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from inspect import signature
from itertools import batched
from numbers import Real
from typing import Any

from envs.arm.found_posture import find_posture
from envs.arm.placed_arm import ORIENTATION_WEIGHT, TOOL_LENGTH, PlacedArm, rounded_posture
from envs.arm.task_poses import FOUND, TaskPoses
from richmap.robots import ROBOTS
from richmap.robots.robot import RobotDescription
from richmap.robots.robot_file import Branch, RobotFile, Stand
from richmap.robots.robots import robot_file

COMMON_BASE = (0.0, 0.0, 0.0)
"""Where arms stand, in [m] in the world: where the xArm6 of the original does."""

MOST_OBSTACLES = 8
"""Cuboids that may stand around an arm."""

BINDS = {"original": False, "embodied": True, "best": True}
"""The settings, and whether joint limits and self-collision bind in them."""


def place_arm(
    robot: str | RobotDescription,
    poses: TaskPoses,
    setting: str = "embodied",
    base: Sequence[float] | None = None,
    yaw: float | None = None,
    branch: str | None = None,
    posture: Sequence[float] | None = None,
    self_collision: bool | None = None,
    orientation_weight: float | None = None,
    narrowed: Sequence[float] = (),
    tool_length: float = TOOL_LENGTH,
    delay: float = 0.0,
    obstacles: int = 0,
) -> PlacedArm:
    """An arm as it does a task in a setting, with single choices replaced where given.

    Args:
        robot: Name of an arm that ships, or the description of another.
        poses: What the task asks of an arm.
        setting: `original`, `embodied` or `best`.
        base: Position of its base, in [m] in the world.
        yaw: Turn of its base, in [rad].
        branch: One that the arm's file states, or `found` for the best that is found at the task's start, which is
            what arms have whose file states none; None for the task's, or else the file's.
        posture: The one that was found before, in [rad], with the branch `found`; it is not sought again.
        self_collision: Whether its links collide with each other.
        orientation_weight: Of its inverse kinematics, in [m/rad].
        narrowed: Joints whose limits are narrower: number from 1 on, least and greatest angle in [rad], of each.
        tool_length: From the flange down, in [m], from 0.02 to 0.3.
        delay: How late a command comes, in [s]: whole control steps, from 0 to 1.
        obstacles: How many cuboids stand around, from 0 to 8.

    Raises:
        ValueError: If there is no such robot or setting, or the arm cannot do the task so.
    """
    if not isinstance(self_collision, bool | None):
        raise ValueError(f"self_collision must be True or False. Got {self_collision!r}")
    _check_numbers(base, yaw, orientation_weight, tool_length, delay, obstacles)
    description, file = _description_and_file(robot)
    given = {
        "base": base, "yaw": yaw, "branch": branch or poses.branch, "self_collision": self_collision,
        "orientation_weight": orientation_weight,
    }  # fmt: skip
    usual = _usual(file, setting)
    chosen = usual | {name: value for name, value in given.items() if value is not None}
    if chosen["base"] is None:
        raise ValueError(
            f"Nobody has found where {description.name} stands best. Give its base, x, y, z in m, as in "
            "arm.base=[0.1,-0.05,0], or find it (python -m benchmark.studies.place_bases robots=[...]) and write it in "
            "the arm's file."
        )
    _check_limited(description, narrowed, chosen["joint_limits"])
    chosen |= {
        "narrowed": tuple(map(float, narrowed)), "tool_length": float(tool_length), "delay": float(delay),
        "obstacles": int(obstacles),
    }  # fmt: skip
    branches = file.branches if file else {}
    name = chosen.pop("branch")
    if name != FOUND and name not in branches:
        raise ValueError(f"{description.name} has no branch {name!r}. Branches: {', '.join([*branches, FOUND])}")
    x, y, z = map(float, chosen.pop("base"))
    stated = branches.get(name, Branch(()))
    arm = PlacedArm(
        description, setting, (x, y, z), posture=stated.posture, branch=name, bounds=stated.bounds, **chosen
    )
    return _in_posture(arm, poses, posture)


def arm_or_named(arm: PlacedArm | None, robot: str, poses: TaskPoses, choices: Mapping[str, Any]) -> PlacedArm:
    """An arm as it stands, or else the one of a name with choices, as environments are given them.

    Raises:
        ValueError: If there is no such choice, or the arm cannot do the task so.
    """
    known = [*signature(place_arm).parameters][2:]
    if unknown := [*choices.keys() - {*known}]:
        raise ValueError(
            f"There is no argument {', '.join(sorted(unknown))}. Choices of an arm: {', '.join(known)}. Beside "
            "these an environment has render_mode, obs_type, and the widths and heights of its pictures."
        )
    if arm is not None and choices:
        raise ValueError(
            f"{', '.join(choices)} goes with robot=, and an arm= stands as it stands. Give one of the two."
        )
    return place_arm(robot, poses, **choices) if arm is None else arm


def _check_numbers(
    base: Sequence[float] | None,
    yaw: float | None,
    orientation_weight: float | None,
    tool_length: float,
    delay: float,
    obstacles: int,
) -> None:
    """Raise `ValueError` unless each of these can be."""
    optional = {"yaw": yaw, "orientation_weight": orientation_weight}
    given = {"tool_length": tool_length, "delay": delay} | {k: v for k, v in optional.items() if v is not None}
    for name, value in given.items():
        if not isinstance(value, Real):
            raise ValueError(f"{name} is a number. Got {value!r}")
    if base is not None and len(base) != 3:
        raise ValueError(f"base is x, y, z in metres. Got {len(base)} numbers: {tuple(base)}")
    if base is not None and not all(map(math.isfinite, base)):
        raise ValueError(f"base is three finite numbers. Got {tuple(base)}")
    if yaw is not None and not math.isfinite(yaw):
        raise ValueError(f"yaw must be a finite number of radians. Got {yaw}")
    if orientation_weight is not None and not 0 < orientation_weight < math.inf:
        raise ValueError(f"orientation_weight must be above 0 m/rad. Got {orientation_weight}")
    if not 0.02 <= tool_length <= 0.3:
        raise ValueError(f"tool_length must lie between 0.02 and 0.3 m. Got {tool_length}")
    if not (0 <= delay <= 1 and math.isclose(10 * delay, round(10 * delay), abs_tol=1e-9)):
        raise ValueError(f"delay must be tenths of a second from 0 to 1. Got {delay}")
    if obstacles not in range(MOST_OBSTACLES + 1):
        raise ValueError(f"obstacles must be a whole number from 0 to {MOST_OBSTACLES}. Got {obstacles}")


def _in_posture(arm: PlacedArm, poses: TaskPoses, posture: Sequence[float] | None) -> PlacedArm:
    """The arm in the posture that was found for it: the given one, or else the best."""
    if posture is not None and arm.branch != FOUND:
        raise ValueError(f"A posture goes with the branch {FOUND}. Here the branch is {arm.branch}.")
    if posture is not None and len(posture) != len(arm.description.joints):
        raise ValueError(f"{arm.robot} has {len(arm.description.joints)} joints. Got a posture of {len(posture)}.")
    if arm.branch != FOUND:
        return arm
    if posture is None:
        posture = _found(replace(arm, obstacles=0), poses).posture
    return replace(arm, posture=rounded_posture(posture))


def _check_limited(robot: RobotDescription, narrowed: Sequence[float], binds: bool) -> None:
    """Raise `ValueError` unless these are joints of the robot with ranges in their limits, and limits bind."""
    joints = len(robot.joints)
    for each in batched(narrowed, 3):
        fits = len(each) == 3 and each[0] in range(1, joints + 1) and each[1] < each[2]
        if not fits:
            raise ValueError(
                f"narrowed is, of each joint, its number (1 to {joints}), its least and its greatest angle in rad. "
                f"Got {tuple(narrowed)}"
            )
    if narrowed and not binds:
        raise ValueError("Joint limits do not bind in the setting original, so none can be narrowed there.")


def usual_choices(robot: str, setting: str) -> dict[str, Any]:
    """What an arm's file has in a setting, and where it says nothing what all arms have: all of an arm that does not
    ship.

    Returns:
        `base` (None if it is yet to be found), `yaw`, `branch`, `self_collision`, `joint_limits` and
        `orientation_weight`.

    Raises:
        ValueError: If there is no such setting.
    """
    return _usual(robot_file(robot) if robot in ROBOTS else None, setting)


def _usual(file: RobotFile | None, setting: str) -> dict[str, Any]:
    """The same of an arm's file; None for one that does not ship."""
    if setting not in BINDS:
        raise ValueError(f"There is no setting {setting!r}. Settings: {', '.join(BINDS)}")
    stand = file.settings.get(setting, Stand(FOUND)) if file else Stand(FOUND)
    base = COMMON_BASE if stand.base is None and setting != "best" else stand.base
    binds = BINDS[setting]
    return {
        "base": base, "yaw": 0.0, "branch": stand.branch, "self_collision": binds, "joint_limits": binds,
        "orientation_weight": ORIENTATION_WEIGHT,
    }  # fmt: skip


def _description_and_file(robot: str | RobotDescription) -> tuple[RobotDescription, RobotFile | None]:
    """An arm, and its file if it ships; None for another arm, also for one that goes by such a name."""
    if isinstance(robot, str):
        file = robot_file(robot)
        return file.scaled, file
    if robot.name not in ROBOTS:
        return robot, None
    file = robot_file(robot.name)
    return (file.scaled, file) if robot in (file.description, file.scaled) else (robot, None)


@lru_cache
def _found(arm: PlacedArm, poses: TaskPoses) -> PlacedArm:
    return find_posture(arm, poses)
