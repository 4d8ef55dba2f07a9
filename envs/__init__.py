"""The block-push task; importing this registers `BlockPush-v0`, which takes an arm, and a name of each of four arms."""

import logging

import gymnasium

from envs.drawing import check_mujoco_gl

check_mujoco_gl()
# robosuite warns on import of optional parts that are not installed and that this task does not use.
logging.getLogger("robosuite_logs").addFilter(lambda record: record.levelno >= logging.ERROR)

MAX_EPISODE_STEPS = 350
"""Control steps, at 10 per second, after which an episode is cut off."""

BLOCK_PUSH = "BlockPush-v0"
"""Gymnasium's name of the task on any arm (`envs.block_push.make.make`)."""

ENVIRONMENTS = {
    "xarm6": "BlockPush-xArm6-v0",
    "ur3": "BlockPush-UR3-v0",
    "ur5": "BlockPush-UR5-v0",
    "ur10": "BlockPush-UR10-v0",
}
"""Short names of it on four arms."""

for _robot, _id in [("xarm6", BLOCK_PUSH), *ENVIRONMENTS.items()]:
    gymnasium.register(
        _id,
        entry_point="envs.block_push.make:make",
        max_episode_steps=MAX_EPISODE_STEPS,
        kwargs={"robot": _robot},
    )
