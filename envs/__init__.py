"""The tasks; importing this registers `BlockPush-v0` and `PressButtons-v0`, which take an arm, and short names."""

import logging

import gymnasium

from envs.block_push.workspace import MAX_EPISODE_STEPS as PUSH_STEPS
from envs.drawing import check_mujoco_gl
from envs.press_buttons.workspace import MAX_EPISODE_STEPS as PRESS_STEPS
from richmap.robots import SOURCE

check_mujoco_gl()
# robosuite warns on import of optional parts that are not installed and that this task does not use.
logging.getLogger("robosuite_logs").addFilter(lambda record: record.levelno >= logging.ERROR)


def _registered(task: str, folder: str, steps: int, arms: str) -> dict[str, str]:
    """Register a task on any arm, as `<task>-v0`, and under a short name on each of these arms: the short names."""
    names = {arm.lower(): f"{task}-{arm}-v0" for arm in arms.split()}
    for robot, name in [(SOURCE, f"{task}-v0"), *names.items()]:
        make = f"envs.{folder}.make:make"
        gymnasium.register(name, entry_point=make, max_episode_steps=steps, kwargs={"robot": robot})
    return names


BLOCK_PUSH = "BlockPush-v0"
"""Gymnasium's name of the task on any arm (`envs.block_push.make.make`)."""
ENVIRONMENTS = _registered("BlockPush", "block_push", PUSH_STEPS, "xArm6 UR3 UR5 UR10")
"""Short names of it by arm."""
PRESS_BUTTONS = "PressButtons-v0"
"""Gymnasium's name of pressing buttons on any arm (`envs.press_buttons.make.make`)."""
PRESS_BUTTONS_ENVIRONMENTS = _registered(
    "PressButtons", "press_buttons", PRESS_STEPS, "xArm6 xArm7 UR3 UR5 UR5e UR10 Panda Gen3"
)
"""Short names of it by arm."""
