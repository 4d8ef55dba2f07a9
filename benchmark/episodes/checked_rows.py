"""Rows of episodes that may be published: of the table's columns, types and ranges, and one for each episode.

That they happened is shown by running them again, `python -m benchmark.replay`, or `benchmark.enter` with `table=`.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_float_dtype, is_integer_dtype

from benchmark.episodes.episode import IDENTITY, NOT_REPLAYED, column_types, row_id, row_name
from benchmark.episodes.table import read_present
from benchmark.settings.command import SettingError

if TYPE_CHECKING:
    from envs.task import Task

FITS = {
    int: is_integer_dtype,
    float: lambda values: is_float_dtype(values) or is_integer_dtype(values),
    bool: is_bool_dtype,
    str: lambda values: values.dropna().map(type).eq(str).all(),
    tuple: lambda values: values.dropna().map(type).eq(tuple).all(),
}
"""Whether a column's values are of a type."""


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
    types = column_types(task.outcome)
    if missing := types.keys() - {*table}:
        raise SettingError(f"{path} is no table of {task.name}: it lacks {', '.join(sorted(missing))}.")
    if strange := {*table} - types.keys():
        raise SettingError(f"{path} has columns that no rollout stores: {', '.join(sorted(strange))}.")
    for name, (kind, optional) in types.items():
        values = table[name]
        if not FITS[kind](values):
            raise SettingError(
                f"{path}: {name} holds {values.dtype}, such as {values.iloc[0]!r}. It should hold {kind.__name__}."
            )
        if values.isna().any() and not optional and name != "cell_size":  # Which is NaN without a field.
            raise SettingError(f"{path}: {name} holds nothing in {values.isna().sum()} rows.")
    table = table[table.episode_seed >= first_seed]
    for said, wrong in out_of_range(table, task).items():
        if wrong.any():
            row = table[wrong].iloc[0]
            raise SettingError(f"{path}: the row {row_id(row)} ({row_name(row)}) cannot be: {said}.")
    return _each_once(table, path, task)


def out_of_range(table: pd.DataFrame, task: "Task") -> dict[str, pd.Series]:
    """Ranges of the columns, and which rows leave them."""
    types = column_types(task.outcome)
    texts = [name for name, (kind, optional) in types.items() if kind is str and not optional]
    numbers = [name for name, (kind, optional) in types.items() if kind is float and not optional]
    numbers.remove("cell_size")  # NaN without a field.
    succeeded = table[task.success].astype(bool)
    return {
        "a text of it has |, <, >, or what is not printed": ~table[texts].map(_is_plain).all(axis=1),
        "a number of it is not finite": ~np.isfinite(table[numbers].astype(float)).all(axis=1),
        "its device is neither cpu nor cuda": ~table.device.isin(["cpu", "cuda"]),
        "its orientation_weight is not above 0": table.orientation_weight <= 0,
        "its lambda is below 0": (table["lambda"] < 0) & (table.entry_hash == ""),
        "its sampling_steps are below 0": table.sampling_steps < 0,
        "its slot is not its seed modulo batch_size": table.slot != table.episode_seed % table.batch_size.clip(1),
        f"its length is not from 1 to {task.max_episode_steps}": ~table.length.between(1, task.max_episode_steps),
        "its failure_cause is none of the task's": ~table.failure_cause.dropna()
        .isin(task.causes)
        .reindex(table.index, fill_value=True),
        f"it has {task.success} and a failure_cause, or neither": table.failure_cause.isna() != succeeded,
    }


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


def _is_plain(text: str) -> bool:
    """Whether a text can stand in a table of the leaderboard."""
    return text.isprintable() and not {*text} & {*"|<>"}
