"""The task that settings name."""

import importlib
from typing import TYPE_CHECKING

from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    from envs.task import Task


_TYPED: dict[str, str] = {}
"""What was given for somebody's own tasks, by their names."""


def chosen_task(name: str) -> "Task":
    """The task of ours of this name, or somebody's own as `module:NAME`.

    Raises:
        SettingError: If there is none.
    """
    from envs.task import Task
    from envs.tasks import TASKS

    for task in TASKS:
        if task.name == name:
            return task
    if ":" not in name:
        names = ", ".join(task.name for task in TASKS)
        raise SettingError(
            f"task={name}: There is no task {name!r}. Tasks: {names}, or one of your own as module:NAME."
        )
    module, attribute = name.split(":", 1)
    try:
        found = getattr(importlib.import_module(module), attribute, None)
    except Exception as error:  # Whatever somebody's module may raise.
        raise SettingError(
            f"task={name}: Task {name!r}: importing {module} raised {type(error).__name__}: {error}"
        ) from error
    if not isinstance(found, Task):
        raise SettingError(f"task={name}: Task {name!r}: {module} has no {attribute} that is an envs.task.Task.")
    _TYPED[found.name] = name
    return found


def typed_task(task: "Task") -> str:
    """What names a task in settings: of somebody's own `module:NAME`, as it was given."""
    return _TYPED.get(task.name, task.name)
