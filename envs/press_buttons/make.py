"""The door of pressing buttons: an environment of an arm's name, or of an arm that stands somewhere already."""

from typing import Any

from envs.arm.environment import on_arm
from envs.arm.placed_arm import PlacedArm
from envs.press_buttons.environment import PressButtonsEnv
from envs.press_buttons.workspace import POSES
from richmap.task_spaces.press_buttons import ROD


def make(robot: str = "xarm6", arm: PlacedArm | None = None, **given: Any) -> PressButtonsEnv:
    """Pressing buttons on an arm.

    Args:
        robot: Name of an arm that ships.
        arm: The arm itself instead.
        given: What `PressButtonsEnv` takes, and `setting`, `base`, `yaw`, `branch`, `self_collision`,
            `orientation_weight`, `narrowed`, `delay`, `obstacles`, as `envs.arm.place_arm.place_arm` has them.
    """
    if "tool_length" in given:
        raise ValueError(f"Buttons are pressed with a rod of {ROD} m, and take no tool_length. Leave it out.")
    return on_arm(PressButtonsEnv, POSES, robot, arm, given)


make.metadata = PressButtonsEnv.metadata  # type: ignore[attr-defined]  # By it Gymnasium opens a window for "human".
