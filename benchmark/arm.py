"""The arm that settings describe, checked before anything is rolled out on it."""

from functools import cache
from typing import TYPE_CHECKING

from benchmark.command import SettingError
from benchmark.config import OracleConfig, RunConfig

if TYPE_CHECKING:
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


@cache
def _able(arm: "ArmSetting") -> "ArmSetting":
    """The arm, if it can hold its tool over the task's start."""
    from envs.arms import make_kinematics, start_posture

    start_posture(make_kinematics(arm), arm)
    return arm
