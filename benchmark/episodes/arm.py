"""The arm that settings describe, checked before anything is rolled out on it; and the columns that tell an arm."""

from collections.abc import Mapping
from itertools import batched
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.settings.config import ConditionConfig, OracleConfig, RunConfig
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    import pandas as pd

    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task

BASE = ["base_x", "base_y", "base_z"]
"""Columns of the position of an arm's base, in [m]."""

ARM = [
    "setting", "robot", "robot_fingerprint", *BASE, "base_yaw", "posture", "self_collision", "joint_limits",
    "orientation_weight", "narrowed", "tool_length", "delay", "obstacles",
]  # fmt: skip
"""Columns that tell an arm in tables of episodes."""

TUPLES = ("posture", "narrowed")
"""Those that hold several numbers."""

SINCE = {"narrowed": (), "tool_length": 0.04, "delay": 0.0, "obstacles": 0}
"""Columns that rows of before lack, and what the arms of all of them had."""


def chosen_arm(config: RunConfig | OracleConfig | ConditionConfig, task: "Task") -> "PlacedArm":
    """The setting's arm with the single choices replaced, as it does a task.

    Raises:
        SettingError: If the arm cannot hold its tool over the task's start so, or is to stand among obstacles and the
            task has none.
    """
    from envs.arm.place_arm import place_arm
    from envs.arm.placed_arm import start_posture

    if config.arm.obstacles and not task.has_obstacles:
        raise SettingError(f"arm.obstacles={config.arm.obstacles}: the task {task.name} has none. Leave it out.")
    poses = task.poses
    try:
        robot = config.robot if isinstance(config, ConditionConfig) else config.robot.load()
        arm = place_arm(robot, poses, config.setting, **vars(config.arm))
        start_posture(arm, arm.kinematics(), poses.start)
        return arm
    except ValueError as error:
        raise SettingError(f"arm: {error}") from error


def suite_arms(conditions: Mapping[str, ConditionConfig]) -> "dict[str, PlacedArm]":
    """The arm of each condition of a suite, by the condition's name.

    Raises:
        SettingError: If one cannot hold its tool over its task's start so.
    """
    return {name: chosen_arm(condition, chosen_task(condition.task)) for name, condition in conditions.items()}


def chosen_arms(config: RunConfig, task: "Task") -> "list[PlacedArm]":
    """The arms of a run of a task: of its suite, or the one that settings describe.

    Raises:
        SettingError: If one cannot hold its tool over the task's start so.
    """
    return [chosen_arm(each, task) for each in config.conditions.values()] or [chosen_arm(config, task)]


def arm_columns(arm: "PlacedArm") -> dict[str, Any]:
    """An arm's values of the columns `ARM`."""
    return {
        "setting": arm.setting,
        "robot": arm.robot,
        "robot_fingerprint": arm.robot_fingerprint,
        **dict(zip(BASE, arm.base, strict=True)),
        "base_yaw": arm.yaw,
        "posture": arm.stored_posture,
        "self_collision": arm.self_collision,
        "joint_limits": arm.joint_limits,
        "orientation_weight": arm.orientation_weight,
        "narrowed": arm.narrowed,
        "tool_length": arm.tool_length,
        "delay": arm.delay,
        "obstacles": arm.obstacles,
    }


def choices_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """What a row's arm is placed by, as `envs.arm.place_arm.place_arm` and `ArmConfig` have it."""
    from envs.arm.task_poses import FOUND

    branch, since = branch_of(row), {name: row.get(name, usual) for name, usual in SINCE.items()}
    return {
        "base": [*base_of(row)],
        "yaw": float(row["base_yaw"]),
        "branch": branch,
        "posture": [*map(float, row["posture"])] if branch == FOUND else None,
        "self_collision": bool(row["self_collision"]),
        "orientation_weight": float(row["orientation_weight"]),
        "narrowed": [*map(float, since["narrowed"])],
        "tool_length": float(since["tool_length"]),
        "delay": float(since["delay"]),
        "obstacles": int(since["obstacles"]),
    }


def base_of(row: Mapping[str, Any]) -> tuple[float, float, float]:
    """Position of the base of a row's arm, in [m]."""
    x, y, z = (float(row[name]) for name in BASE)
    return x, y, z


def base_text(row: Mapping[str, Any]) -> str:
    """The same as a text, in [m]."""
    return " ".join(f"{x:g}" for x in base_of(row))


def branch_of(row: Mapping[str, Any]) -> str:
    """What the file of a row's arm calls the branch that this posture names; `found` where it states none."""
    from envs.arm.task_poses import FOUND
    from richmap.robots import ROBOTS
    from richmap.robots.robots import robot_file

    stated = robot_file(row["robot"]).branches if row["robot"] in ROBOTS else {}
    return next((name for name, branch in stated.items() if branch.posture == tuple(row["posture"])), FOUND)


def branch_text(row: Mapping[str, Any]) -> str:
    """The same for people: wrist out, or branch found."""
    from envs.arm.task_poses import FOUND

    branch = branch_of(row)
    return f"branch {FOUND}" if branch == FOUND else branch.replace("_", " ")


def setting_text(row: Mapping[str, Any]) -> str:
    """The setting, and what is otherwise than on the setting's arm."""
    return ", ".join([row["setting"], *changes(row, row["setting"])])


def changes(row: Mapping[str, Any], setting: str) -> list[str]:
    """What is otherwise than on a setting's arm, a text each."""
    from envs.arm.place_arm import usual_choices

    usual = usual_choices(row["robot"], setting)
    texts = {
        f"base {base_text(row)} m": base_of(row) != tuple(usual["base"] or ()),
        f"yaw {row['base_yaw']:g} rad": row["base_yaw"] != usual["yaw"],
        branch_text(row): branch_of(row) != usual["branch"],
        f"self-collision {'on' if row['self_collision'] else 'off'}": row["self_collision"] != usual["self_collision"],
        f"joint limits {'on' if row['joint_limits'] else 'off'}": row["joint_limits"] != usual["joint_limits"],
        f"orientation weight {row['orientation_weight']:g}": row["orientation_weight"] != usual["orientation_weight"],
        **{f"joint {int(n)} from {low:g} to {high:g} rad": True for n, low, high in batched(row["narrowed"], 3)},
        f"tool {row['tool_length']:g} m": row["tool_length"] != SINCE["tool_length"],
        f"commands {row['delay']:g} s late": row["delay"] != SINCE["delay"],
        f"{row['obstacles']} obstacles": row["obstacles"] != SINCE["obstacles"],
    }
    return [text for text, differs in texts.items() if differs]


def arm_name(arm: "PlacedArm") -> str:
    """What folders are called that hold something of an arm as it stands: ur10-embodied, or ur10-embodied-wrist_out."""
    return f"{arm.robot}-{setting_text(arm_columns(arm))}".replace(", ", "-").replace(" ", "_")


def of_arm(episodes: "pd.DataFrame", arm: "PlacedArm") -> "pd.DataFrame":
    """The rows of an arm that stood and held its tool like this one."""
    return episodes if episodes.empty else alike(episodes, arm_columns(arm))


def usual_rows(episodes: "pd.DataFrame", setting: str) -> "pd.DataFrame":
    """The rows of arms of a setting with nothing otherwise than there."""
    rows = episodes[episodes.setting == setting]
    usual = {arm: not changes(dict(zip(ARM, arm, strict=True)), setting) for arm in {*_arms(rows)}}
    return rows[np.array([usual[arm] for arm in _arms(rows)], dtype=bool)]


def alike(episodes: "pd.DataFrame", values: Mapping[str, Any]) -> "pd.DataFrame":
    """The rows that have these values in these columns."""
    for name, value in values.items():
        same = [each == value for each in episodes[name]] if name in TUPLES else episodes[name] == value
        episodes = episodes[np.array(same, dtype=bool)]
    return episodes


def _arms(rows: "pd.DataFrame") -> list[tuple[Any, ...]]:
    """The columns `ARM` of each row."""
    return [*rows[ARM].itertuples(index=False, name=None)]
