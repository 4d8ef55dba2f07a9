"""What an arm is called that stands or is limited otherwise than its setting says."""

import pytest

from benchmark.episodes.arm import arm_columns, arm_name, setting_text
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
        (
            {"narrowed": (1.0, -1.0, 1.0), "tool_length": 0.12, "delay": 0.2},
            "embodied, joint 1 from -1 to 1 rad, tool 0.12 m, commands 0.2 s late",
            "ur10-embodied-joint_1_from_-1_to_1_rad-tool_0.12_m-commands_0.2_s_late",
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
