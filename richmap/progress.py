"""What commands show as they work: plain lines, and the progress bar of every long stage."""

from datetime import timedelta
from time import monotonic
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.status import Status
from rich.text import Text

SAY_EVERY = 60.0
"""Time between two lines where there is no terminal, in [s]."""


class SpokenProgress(Progress):
    """Rich's progress, which says a line a minute and one at the end where no bar can move: without a terminal."""

    def __init__(self, *columns: ProgressColumn, **settings: Any) -> None:
        super().__init__(*columns, **settings)
        self._speaks = not (self.console.is_terminal or self.console.is_jupyter)
        self.disable = self._speaks
        self.live.auto_refresh = not self._speaks  # `track` then counts by itself, not by a thread that draws.
        self._said = monotonic()

    def update(self, task_id: TaskID, **changes: Any) -> None:
        super().update(task_id, **changes)
        self._say_now_and_then(self._tasks[task_id])

    def advance(self, task_id: TaskID, advance: int | float = 1) -> None:
        super().advance(task_id, advance)
        self._say_now_and_then(self._tasks[task_id])

    def stop(self) -> None:
        super().stop()
        for task in self.tasks if self._speaks else ():
            self._say(task, f", {timedelta(seconds=round(task.elapsed or 0))} used")

    def _say_now_and_then(self, task: Task) -> None:
        if self._speaks and monotonic() - self._said >= SAY_EVERY:
            self._said, left = monotonic(), task.time_remaining
            said = "" if left is None or task.finished else f", about {max(1, round(left / 60))} min left"
            self._say(task, said)

    def _say(self, task: Task, time: str) -> None:
        texts = [column(task) for column in self.columns if isinstance(column, (TextColumn, MofNCompleteColumn))]
        self.console.print(" ".join(map(str, texts)) + time, soft_wrap=True, markup=False)


class _PlainConsole(Console):
    def status(self, status: RenderableType, **settings: Any) -> Status:
        return super().status(Text(status) if isinstance(status, str) else status, **settings)


def plain_console(**settings: Any) -> Console:
    """A console that prints a text as it is, whatever brackets and colons are in it."""
    return _PlainConsole(markup=False, emoji=False, **settings)


def number_of(what: str, number: int) -> str:
    """So many of something: 1 step, 2 steps."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def progress_bar(console: Console | None = None, period: int | float = 30.0) -> SpokenProgress:
    """A bar with count, time used and time left, which is that at the speed of the last `period` seconds."""
    return SpokenProgress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        speed_estimate_period=period,
    )
