"""The arm that settings describe, checked before anything is rolled out on it."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from benchmark.settings.command import SettingError
from benchmark.settings.config import OracleConfig, RunConfig
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    import pandas as pd

    from envs.arm.placed_arm import PlacedArm


ARM = ["setting", "robot", "base", "branch", "self_collision", "joint_limits", "orientation_weight"]
"""Columns that tell an arm in tables of episodes."""


def chosen_arm(config: RunConfig | OracleConfig) -> "PlacedArm":
    """The setting's arm with the single choices replaced.

    Raises:
        SettingError: If the arm cannot hold its tool over the task's start so.
    """
    from envs.arm.place_arm import place_arm

    poses = chosen_task(config.task).poses
    try:
        return _able(place_arm(config.robot.load(), poses, config.setting, **vars(config.arm)), poses.start)
    except ValueError as error:
        raise SettingError(f"arm: {error}") from error


def arm_columns(arm: "PlacedArm") -> dict[str, Any]:
    """An arm's values of the columns `ARM`."""
    return {
        "robot": arm.robot,
        "setting": arm.setting,
        "base": " ".join(f"{x:g}" for x in arm.base),
        "branch": arm.branch.removeprefix("wrist_"),
        "self_collision": arm.self_collision,
        "joint_limits": arm.joint_limits,
        "orientation_weight": arm.orientation_weight,
    }


def arm_of(row: Mapping[str, Any]) -> "PlacedArm":
    """The arm of a row, as it stood.

    Raises:
        SettingError: If it is none of those that ship.
    """
    from envs.block_push.arm import block_push_arm

    try:
        return block_push_arm(
            row["robot"],
            row["setting"],
            base=tuple(map(float, row["base"].split())),
            branch=f"wrist_{row['branch']}" if row["branch"] in ("out", "in") else row["branch"],
            self_collision=bool(row["self_collision"]),
            orientation_weight=float(row["orientation_weight"]),
        )
    except ValueError as error:
        raise SettingError(f"A row's arm: {error}") from error


def setting_text(row: Mapping[str, Any]) -> str:
    """The setting, and what is otherwise than on the setting's arm."""
    return ", ".join([row["setting"], *changes(row)])


def changes(row: Mapping[str, Any]) -> list[str]:
    """What is otherwise than on the setting's arm, a text each."""
    usual = usual_columns(row["robot"], row["setting"])
    texts = {
        "base": f"base {row['base']} m",
        "branch": f"wrist {row['branch']}" if row["branch"] in ("out", "in") else f"branch {row['branch']}",
        "self_collision": f"self-collision {'on' if row['self_collision'] else 'off'}",
        "joint_limits": f"joint limits {'on' if row['joint_limits'] else 'off'}",
        "orientation_weight": f"orientation weight {row['orientation_weight']:g}",
    }
    return [text for name, text in texts.items() if row[name] != usual[name]]


def usual_columns(robot: str, setting: str) -> dict[str, object]:
    """The columns `ARM` of an arm as its setting has it; of one that does not ship, as it has others."""
    from envs.arm.place_arm import usual_choices

    usual = usual_choices(robot, setting)
    del usual["yaw"]
    about = {"base": " ".join(f"{x:g}" for x in usual["base"] or ()), "branch": usual["branch"].removeprefix("wrist_")}
    return usual | about | {"robot": robot, "setting": setting}


def arm_name(arm: "PlacedArm") -> str:
    """What folders are called that hold something of an arm as it stands: ur10-embodied, or ur10-embodied-wrist_out."""
    return f"{arm.robot}-{setting_text(arm_columns(arm))}".replace(", ", "-").replace(" ", "_")


def of_arm(episodes: "pd.DataFrame", arm: "PlacedArm") -> "pd.DataFrame":
    """The rows of an arm that stood and held its tool like this one."""
    import pandas as pd

    if episodes.empty:
        return episodes
    columns = pd.Series(arm_columns(arm))
    return episodes[(episodes[columns.index] == columns).all(axis=1)]


def stored_arms(episodes: "pd.DataFrame", robots: Sequence[str], settings: Sequence[str]) -> "list[PlacedArm]":
    """The arms of these robots and settings with episodes of direct transfer and an upright tool, as they stood.

    Robot by robot, setting by setting, and in each the setting's own arm before those with another base or branch.
    """
    if episodes.empty:
        return []
    rows = episodes[(episodes.method == "direct") & episodes.robot.isin(robots) & episodes.setting.isin(settings)]
    stored = rows[ARM].drop_duplicates().to_dict("records")
    usual = [usual_columns(row["robot"], row["setting"]) for row in stored]
    upright = [
        (row, row != as_usual)
        for row, as_usual in zip(stored, usual, strict=True)
        if row["orientation_weight"] == as_usual["orientation_weight"]
    ]
    upright.sort(
        key=lambda pair: (
            robots.index(pair[0]["robot"]), settings.index(pair[0]["setting"]), pair[1], setting_text(pair[0]),
        )
    )  # fmt: skip
    return [arm_of(row) for row, _ in upright]


@cache
def _able(arm: "PlacedArm", start: tuple[float, float, float]) -> "PlacedArm":
    """The arm, if it can hold its tool over the task's start."""
    from envs.arm.placed_arm import start_posture

    start_posture(arm, arm.kinematics(), start)
    return arm
