"""The tasks that there are: the one place where a further one is added."""

import importlib

from envs.block_push.task import BLOCK_PUSH
from envs.press_buttons.task import PRESS_BUTTONS
from envs.task import Task

TASKS: tuple[Task, ...] = (BLOCK_PUSH, PRESS_BUTTONS)


def task_named(name: str) -> Task:
    """A task of ours by its name, or somebody's own as `module:NAME`.

    Raises:
        ValueError: If there is none.
    """
    for task in TASKS:
        if task.name == name:
            return task
    if ":" not in name:
        names = ", ".join(task.name for task in TASKS)
        raise ValueError(f"There is no task {name!r}. Tasks: {names}, or one of your own as module:NAME.")
    module, attribute = name.split(":", 1)
    try:
        found = getattr(importlib.import_module(module), attribute, None)
    except Exception as error:  # Whatever somebody's module may raise.
        raise ValueError(f"Task {name!r}: importing {module} raised {type(error).__name__}: {error}") from error
    if not isinstance(found, Task):
        raise ValueError(f"Task {name!r}: {module} has no {attribute} that is an envs.task.Task.")
    return found
