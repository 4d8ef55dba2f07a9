"""The block-push task; importing this registers `BlockPush-xArm6-v0`, `-UR3-v0`, `-UR5-v0` and `-UR10-v0`."""

import logging

import gymnasium

# robosuite warns on import of optional parts that are not installed and that this task does not use.
logging.getLogger("robosuite_logs").addFilter(lambda record: record.levelno >= logging.ERROR)

MAX_EPISODE_STEPS = 350
"""Control steps, at 10 per second, after which an episode is cut off."""

ENVIRONMENTS = {
    "xarm6": "BlockPush-xArm6-v0",
    "ur3": "BlockPush-UR3-v0",
    "ur5": "BlockPush-UR5-v0",
    "ur10": "BlockPush-UR10-v0",
}
"""Gymnasium's name of the task on each robot."""

for _robot, _id in ENVIRONMENTS.items():
    gymnasium.register(
        _id,
        entry_point="envs.block_push.environment:BlockPushEnv",
        max_episode_steps=MAX_EPISODE_STEPS,
        kwargs={"robot": _robot},
    )
