"""The tasks that there are: the one place where a further one is added."""

from envs.block_push.task import BLOCK_PUSH
from envs.press_buttons.task import PRESS_BUTTONS
from envs.task import Task

TASKS: tuple[Task, ...] = (BLOCK_PUSH, PRESS_BUTTONS)
