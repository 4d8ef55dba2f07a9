"""Rows of episodes that may be published: of the table's columns, types and ranges, and one for each episode.

That they happened is shown by running them again, `python -m benchmark.replay`, or `benchmark.enter` with `table=`.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from benchmark.episodes.episode import IDENTITY, NOT_REPLAYED, column_types, row_id, row_name
from benchmark.episodes.table import read_present
from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    from envs.task import Task


def read_checked(path: Path, task: "Task", first_seed: int = 0) -> pd.DataFrame:
    """The episodes of a task in a table, or in all tables of a folder, from an episode seed on.

    Rows of earlier episodes and of other episode versions are left out: what is not published need not be fit for it.

    Raises:
        SettingError: If a column is missing, strange, of another type or out of its range, or two rows of one episode
            say different things.
    """
    table = read_present(path, task, each_once=False)
    if table.empty:
        return table
    if strange := {*table} - column_types(task.outcome).keys():
        raise SettingError(f"{path} has columns that no rollout stores: {', '.join(sorted(strange))}.")
    table = table[table.episode_seed >= first_seed]
    _check_texts(path, table, task)
    return _each_once(table, path, task)


def _each_once(table: pd.DataFrame, path: Path, task: "Task") -> pd.DataFrame:
    """The rows without those that say the same of one episode.

    Raises:
        SettingError: If two say different things.
    """
    compared = [name for name in column_types(task.outcome) if name not in NOT_REPLAYED]
    table = table.drop_duplicates(compared, ignore_index=True)
    doubled = table[table.duplicated(IDENTITY)]
    if len(doubled):
        row = doubled.iloc[0]
        raise SettingError(
            f"Two rows under {path} are of one episode ({row_name(row)}) and say different things. See which one "
            f"replays: python -m benchmark.replay table={path} row={row_id(row)}. Remove the other."
        )
    return table


def _check_texts(path: Path, table: pd.DataFrame, task: "Task") -> None:
    """Whether each text can stand in a table of the leaderboard.

    Raises:
        SettingError: If one cannot.
    """
    for name, (kind, optional) in column_types(task.outcome).items():
        if kind is str and not optional:
            for text in table[name].unique():
                if {*text} & {*"|<>"}:
                    raise SettingError(f"{path}: {name} holds {text!r}. What is published has no |, < or >.")
