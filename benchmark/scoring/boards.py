"""The published protocols' tables, from all test episodes in a folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.config import RunConfig
from benchmark.settings.recipe import USUAL
from benchmark.settings.scenes import FIRST_TEST_SEED
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task, typed_task

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.scoring.ranking import Protocol
    from benchmark.scoring.suite_table import Standing
    from envs.task import Task


@dataclass(frozen=True)
class Boards:
    """What the leaderboard shows."""

    tables: "dict[Protocol, pd.DataFrame]"
    """Of each protocol that has rows (`ranking.leaderboard`), with oracles."""
    standings: "Sequence[Standing]"
    """Of each suite whose ceilings are frozen."""


def read_boards(folder: Path, task: "Task", recipe: str = USUAL, protocols: Sequence[str] = ()) -> Boards:
    """The boards of a task, of the policies of a recipe.

    Args:
        folder: Every table of episodes below it is read, of policies and of oracles.
        task: What the episodes are of.
        recipe: Of the policies; ceilings are of the usual one.
        protocols: Names of those that are asked for; () for all, and the suites.

    Raises:
        SettingError: If there are no rows that count.
    """
    from benchmark.artifacts.known_policies import shipped
    from benchmark.episodes.checked_rows import read_checked
    from benchmark.scoring.oracle_scores import with_oracles
    from benchmark.scoring.ranking import counted, leaderboard, protocols_of
    from benchmark.scoring.suite_table import standings
    from richmap.progress import plain_console, progress_bar

    tables = {}
    with progress_bar(plain_console(stderr=True)) as progress:
        reading = progress.add_task("Reading episodes", total=None)
        episodes = read_checked(folder, task, FIRST_TEST_SEED)
        progress.remove_task(reading)
        if recipe != USUAL and len(episodes):
            episodes = episodes[episodes.entry_hash == ""]
        ours = shipped(recipe, task.name) or {*episodes.get("checkpoint_hash", ())}
        for protocol in protocols_of(task):
            if protocols and protocol.name not in protocols:
                continue
            rows = counted(episodes, protocol, ours)
            if len(rows):
                track = partial(progress.track, description=f"Rows of protocol {protocol.name}")
                tables[protocol] = with_oracles(leaderboard(rows, protocol, task, track), episodes, protocol, task)
    if not tables:
        of_task = "" if task.name == RunConfig.task else f"task={typed_task(task)} "
        raise SettingError(
            f"There are no test episodes (seeds from {FIRST_TEST_SEED}) of a protocol that count, in any "
            f"table of episodes under {folder}. Make some: python -m benchmark.run {of_task}protocol=strict "
            f"robot=ur3 recipe={recipe}. For a table of any other rows: python -m benchmark.show {of_task}"
            f"table={folder}"
        )

    @cache
    def read(name: str) -> "pd.DataFrame":
        return episodes if name == task.name else read_checked(folder, chosen_task(name), FIRST_TEST_SEED)

    return Boards(tables, standings(folder, task.name, read) if recipe == USUAL and not protocols else [])
