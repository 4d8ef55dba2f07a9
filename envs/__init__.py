"""The tasks; importing this registers `BlockPush-v0` and `PressButtons-v0`, which take an arm, and short names."""

import logging

import gymnasium

from envs.drawing import check_mujoco_gl

check_mujoco_gl()
# robosuite warns on import of optional parts that are not installed and that this task does not use.
logging.getLogger("robosuite_logs").addFilter(lambda record: record.levelno >= logging.ERROR)

MAX_EPISODE_STEPS = 350
"""Control steps, at 10 per second, after which an episode of block push is cut off."""
MAX_PRESS_STEPS = 130
"""Likewise of pressing buttons (`envs.press_buttons.workspace.MAX_EPISODE_STEPS`, without loading it)."""

BLOCK_PUSH = "BlockPush-v0"
"""Gymnasium's name of the task on any arm (`envs.block_push.make.make`)."""

ENVIRONMENTS = {
    "xarm6": "BlockPush-xArm6-v0",
    "ur3": "BlockPush-UR3-v0",
    "ur5": "BlockPush-UR5-v0",
    "ur10": "BlockPush-UR10-v0",
}
"""Short names of it on four arms."""

PRESS_BUTTONS = "PressButtons-v0"
"""Gymnasium's name of pressing buttons on any arm (`envs.press_buttons.make.make`)."""

PRESS_BUTTONS_ENVIRONMENTS = {
    "xarm6": "PressButtons-xArm6-v0",
    "xarm7": "PressButtons-xArm7-v0",
    "ur3": "PressButtons-UR3-v0",
    "ur5": "PressButtons-UR5-v0",
    "ur5e": "PressButtons-UR5e-v0",
    "ur10": "PressButtons-UR10-v0",
    "panda": "PressButtons-Panda-v0",
    "gen3": "PressButtons-Gen3-v0",
}
"""Short names of it on eight arms."""

for _robot, _id in [("xarm6", BLOCK_PUSH), *ENVIRONMENTS.items()]:
    gymnasium.register(
        _id,
        entry_point="envs.block_push.make:make",
        max_episode_steps=MAX_EPISODE_STEPS,
        kwargs={"robot": _robot},
    )

for _robot, _id in [("xarm6", PRESS_BUTTONS), *PRESS_BUTTONS_ENVIRONMENTS.items()]:
    gymnasium.register(
        _id,
        entry_point="envs.press_buttons.make:make",
        max_episode_steps=MAX_PRESS_STEPS,
        kwargs={"robot": _robot},
    )
