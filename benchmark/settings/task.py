"""The task that settings name."""

from typing import TYPE_CHECKING

from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    from envs.task import Task


def chosen_task(name: str) -> "Task":
    """The task of this name, or somebody's own as `module:NAME`.

    Raises:
        SettingError: If there is none.
    """
    from envs.tasks import task_named

    try:
        return task_named(name)
    except ValueError as error:
        raise SettingError(f"task={name}: {error}") from error
