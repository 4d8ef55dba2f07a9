"""The arm that settings describe, checked before anything is rolled out on it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

from benchmark.settings.command import SettingError
from benchmark.settings.config import OracleConfig, RunConfig

if TYPE_CHECKING:
    import pandas as pd

    from envs.arm.arms import ArmSetting


ARM = ["setting", "robot", "base", "branch", "self_collision", "joint_limits", "orientation_weight"]
"""Columns that tell an arm in tables of episodes."""


def chosen_arm(config: RunConfig | OracleConfig) -> "ArmSetting":
    """The setting's arm with the single choices replaced.

    Raises:
        SettingError: If the arm cannot hold its tool over the task's start so.
    """
    from envs.arm.arms import arm_setting

    try:
        return _able(arm_setting(config.robot.name, config.setting, **vars(config.arm)))
    except ValueError as error:
        raise SettingError(f"arm: {error}") from error


def arm_columns(arm: "ArmSetting") -> dict[str, object]:
    """An arm's values of the columns `ARM`."""
    return {
        "robot": arm.robot,
        "setting": arm.name,
        "base": " ".join(f"{x:g}" for x in arm.base),
        "branch": arm.wrist,
        "self_collision": arm.self_collision,
        "joint_limits": arm.joint_limits,
        "orientation_weight": arm.orientation_weight,
    }


def arm_of(row: Mapping[str, Any]) -> "ArmSetting":
    """The arm of a row, as it stood."""
    from envs.arm.arms import arm_setting

    base = tuple(map(float, row["base"].split()))
    return replace(
        arm_setting(row["robot"], row["setting"]),
        base=base,
        wrist=row["branch"],
        self_collision=bool(row["self_collision"]),
        orientation_weight=float(row["orientation_weight"]),
    )


def setting_text(row: Mapping[str, Any]) -> str:
    """The setting, and what is otherwise than on the setting's arm."""
    return ", ".join([row["setting"], *changes(row)])


def changes(row: Mapping[str, Any]) -> list[str]:
    """What is otherwise than on the setting's arm, a text each."""
    from envs.arm.arms import arm_setting

    usual = arm_columns(arm_setting(row["robot"], row["setting"]))
    texts = {
        "base": f"base {row['base']} m",
        "branch": f"wrist {row['branch']}",
        "self_collision": f"self-collision {'on' if row['self_collision'] else 'off'}",
        "joint_limits": f"joint limits {'on' if row['joint_limits'] else 'off'}",
        "orientation_weight": f"orientation weight {row['orientation_weight']:g}",
    }
    return [text for name, text in texts.items() if row[name] != usual[name]]


def arm_name(arm: "ArmSetting") -> str:
    """What folders are called that hold something of an arm as it stands: ur10-embodied, or ur10-embodied-wrist_out."""
    return f"{arm.robot}-{setting_text(arm_columns(arm))}".replace(", ", "-").replace(" ", "_")


def of_arm(episodes: "pd.DataFrame", arm: "ArmSetting") -> "pd.DataFrame":
    """The rows of an arm that stood and held its tool like this one."""
    import pandas as pd

    if episodes.empty:
        return episodes
    columns = pd.Series(arm_columns(arm))
    return episodes[(episodes[columns.index] == columns).all(axis=1)]


def stored_arms(episodes: "pd.DataFrame", robots: Sequence[str], settings: Sequence[str]) -> "list[ArmSetting]":
    """The arms of these robots and settings with episodes of direct transfer and an upright tool, as they stood.

    Robot by robot, setting by setting, and in each the setting's own arm before those with another base or wrist.
    """
    from envs.arm.arms import arm_setting

    if episodes.empty:
        return []
    rows = episodes[(episodes.method == "direct") & episodes.robot.isin(robots) & episodes.setting.isin(settings)]
    arms = [arm_of(row) for row in rows[ARM].drop_duplicates().to_dict("records")]
    usual = {arm: arm_setting(arm.robot, arm.name) for arm in arms}
    upright = [arm for arm in arms if arm.orientation_weight == usual[arm].orientation_weight]
    return sorted(
        upright,
        key=lambda arm: (robots.index(arm.robot), settings.index(arm.name), arm != usual[arm], arm_name(arm)),
    )


@cache
def _able(arm: "ArmSetting") -> "ArmSetting":
    """The arm, if it can hold its tool over the task's start."""
    from envs.arm.arms import make_kinematics, start_posture
    from envs.block_push.scene import START

    start_posture(make_kinematics(arm), arm, START)
    return arm
