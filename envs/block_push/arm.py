"""An arm at the table of block push."""

from typing import Any

from envs.arm.place_arm import place_arm
from envs.arm.placed_arm import PlacedArm
from envs.block_push.workspace import POSES
from richmap.robots.robot import RobotDescription


def block_push_arm(robot: str | RobotDescription, setting: str = "embodied", **choices: Any) -> PlacedArm:
    """An arm as it pushes blocks in a setting; `choices` as `envs.arm.place_arm.place_arm` has them."""
    return place_arm(robot, POSES, setting, **choices)
