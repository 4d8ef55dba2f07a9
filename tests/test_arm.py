"""What an arm is called that stands or is limited otherwise than its setting says."""

from dataclasses import replace

import pandas as pd
import pytest

from benchmark.episodes.arm import arm_columns, arm_name, setting_text, stored_arms
from envs.block_push.arm import block_push_arm


@pytest.mark.parametrize(
    "changes, text, name",
    [
        ({}, "embodied", "ur10-embodied"),
        ({"branch": "wrist_out"}, "embodied, wrist out", "ur10-embodied-wrist_out"),
        ({"base": (0.1, 0.0, 0.0)}, "embodied, base 0.1 0 0 m", "ur10-embodied-base_0.1_0_0_m"),
        (
            {"self_collision": False, "orientation_weight": 0.01},
            "embodied, self-collision off, orientation weight 0.01",
            "ur10-embodied-self-collision_off-orientation_weight_0.01",
        ),
    ],
)
def test_an_arm_is_called_by_its_setting_and_what_is_otherwise(changes, text, name):
    arm = block_push_arm("ur10", "embodied", **changes)
    assert setting_text(arm_columns(arm)) == text
    assert arm_name(arm) == name


def test_each_arm_of_a_setting_is_called_by_it_alone():
    for robot in ("xarm6", "ur3", "ur5", "ur10"):
        for setting in ("original", "embodied", "best"):
            assert arm_name(block_push_arm(robot, setting)) == f"{robot}-{setting}"


def test_arms_that_stand_otherwise_come_after_the_settings_own_and_leaning_ones_not_at_all():
    usual = block_push_arm("ur10")
    wrist_out = block_push_arm("ur10", branch="wrist_out")
    others = block_push_arm("ur5"), block_push_arm("ur10", "best")
    arms = [replace(usual, orientation_weight=0.01), wrist_out, usual, *others]
    rows = pd.DataFrame([arm_columns(arm) | {"method": "direct"} for arm in arms])
    asked = ["ur3", "ur10"], ["embodied"]
    assert stored_arms(rows, *asked) == [usual, wrist_out]
    assert stored_arms(rows.assign(method="paper"), *asked) == stored_arms(pd.DataFrame(), *asked) == []
