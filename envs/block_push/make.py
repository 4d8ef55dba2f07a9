"""The door of block push: an environment of an arm's name, or of an arm that stands somewhere already."""

from typing import Any

from envs.arm.environment import on_arm
from envs.arm.placed_arm import PlacedArm
from envs.block_push.environment import BlockPushEnv
from envs.block_push.workspace import POSES


def make(robot: str = "xarm6", arm: PlacedArm | None = None, **given: Any) -> BlockPushEnv:
    """Block push on an arm.

    Args:
        robot: Name of an arm that ships.
        arm: The arm itself instead.
        given: What `BlockPushEnv` takes, and `setting`, `base`, `yaw`, `branch`, `self_collision`,
            `orientation_weight`, `narrowed`, `tool_length`, `delay`, `obstacles`, as `envs.arm.place_arm.place_arm` has
            them.
    """
    return on_arm(BlockPushEnv, POSES, robot, arm, given)


make.metadata = BlockPushEnv.metadata  # type: ignore[attr-defined]  # By it Gymnasium opens a window for "human".
