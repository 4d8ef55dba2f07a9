"""Where and how often the task acts: the few numbers that physics, outcome and environment share."""

import numpy as np

from envs.arm.cuboid import Cuboid
from envs.arm.task_poses import TaskPoses
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE, START

MAX_EPISODE_STEPS = 350
"""Control steps, at 10 per second, after which an episode is cut off."""
WORKSPACE = np.array([[0.15, -0.5], [0.7, 0.5]])
"""Box that the commanded effector is kept in, lower and upper xy in [m]."""
MAX_STEP = 0.1
"""Largest step of the commanded effector along an axis, in [m] per control step."""
LEASH = 0.08
"""Farthest that the command is ahead of the flange, in [m], where an arm is protected: so no error winds up."""
HEIGHT = BLOCK_PUSH_SPACE.steps.position[2]
"""Of the flange above the table, in [m]."""
SPACING = 0.01
"""Of the grid on which it is known where an arm can hold its tool, in [m]."""
POSES = TaskPoses((*START, HEIGHT), (0.2, -0.43), (0.6, 0.28))
"""What is asked of an arm: the start, and from there wherever blocks and targets may be."""
CUBOIDS = (Cuboid((0.02, 0.02, 0.06)), Cuboid((0.03, 0.03, 0.03), (0.15, 0.35)))
"""Obstacles, the one and the other in turn."""
DESCRIPTION = "Push each block into a target of its own."
"""The task in words, for policies that read them: the same in demonstrations and environments."""
