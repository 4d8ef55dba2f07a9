"""The door of block push: an environment of an arm's name, or of an arm that stands somewhere already."""

from typing import Any

from envs.arm.place_arm import arm_or_named
from envs.arm.placed_arm import PlacedArm
from envs.arm.renderer import HEIGHT, WIDTH
from envs.block_push.environment import BlockPushEnv
from envs.block_push.workspace import POSES


def make(
    robot: str = "xarm6",
    arm: PlacedArm | None = None,
    obs_type: str = "state",
    render_mode: str | None = None,
    observation_width: int = 96,
    observation_height: int = 96,
    visualization_width: int = WIDTH,
    visualization_height: int = HEIGHT,
    **choices: Any,
) -> BlockPushEnv:
    """Block push on an arm.

    Args:
        robot: Name of an arm that ships.
        arm: The arm itself instead.
        obs_type: As `BlockPushEnv` has it; likewise the next.
        render_mode: None or `rgb_array`.
        observation_width: Of the picture that is observed, in pixels; likewise the next.
        observation_height: See there.
        visualization_width: Of the picture that `render` gives, in pixels; likewise the next.
        visualization_height: See there.
        choices: `setting`, `base`, `yaw`, `branch`, `self_collision`, `orientation_weight`, `narrowed`, `tool_length`,
            `delay`, `obstacles`, as `envs.arm.place_arm.place_arm` has them.
    """
    return BlockPushEnv(
        arm_or_named(arm, robot, POSES, choices),
        obs_type,
        render_mode,
        observation_width,
        observation_height,
        visualization_width,
        visualization_height,
    )


make.metadata = BlockPushEnv.metadata  # type: ignore[attr-defined]  # By it Gymnasium opens a window for "human".
