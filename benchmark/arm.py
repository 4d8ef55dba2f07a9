"""The arm that settings describe, checked before anything is rolled out on it."""

from functools import cache
from typing import TYPE_CHECKING

from benchmark.command import SettingError
from benchmark.config import OracleConfig, RunConfig

if TYPE_CHECKING:
    import pandas as pd

    from envs.arms import ArmSetting


def chosen_arm(config: RunConfig | OracleConfig) -> "ArmSetting":
    """The setting's arm with the single choices replaced.

    Raises:
        SettingError: If the arm cannot hold its tool over the task's start so.
    """
    from envs.arms import arm_setting

    try:
        return _able(arm_setting(config.robot.name, config.setting, **vars(config.arm)))
    except ValueError as error:
        raise SettingError(f"arm: {error}") from error


def arm_columns(arm: "ArmSetting") -> dict[str, object]:
    """What tells an arm in tables of episodes (`benchmark.ranking.ARM`)."""
    return {
        "robot": arm.robot,
        "setting": arm.name,
        "base": " ".join(f"{x:g}" for x in arm.base),
        "branch": arm.wrist,
        "self_collision": arm.self_collision,
        "joint_limits": arm.joint_limits,
        "orientation_weight": arm.orientation_weight,
    }


def of_arm(episodes: "pd.DataFrame", arm: "ArmSetting") -> "pd.DataFrame":
    """The rows of an arm that stood and held its tool like this one."""
    import pandas as pd

    if episodes.empty:
        return episodes
    columns = pd.Series(arm_columns(arm))
    return episodes[(episodes[columns.index] == columns).all(axis=1)]


@cache
def _able(arm: "ArmSetting") -> "ArmSetting":
    """The arm, if it can hold its tool over the task's start."""
    from envs.arms import make_kinematics, start_posture

    start_posture(make_kinematics(arm), arm)
    return arm
