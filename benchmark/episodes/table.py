"""The table of episodes: one row per rollout, from which everything else is derived."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import pyarrow as pa

from benchmark.episodes.arm import ARM, SINCE, alike
from benchmark.episodes.episode import (
    CONDITION,
    IDENTITY,
    Condition,
    Episode,
    as_frame,
    column_types,
    row_id,
    row_name,
)
from benchmark.episodes.parts import (
    check_columns,
    has_checksum,
    of_task,
    parts_below,
    parts_in,
    read_part,
    to_frame,
    write_part,
)
from benchmark.settings.setting import SettingError
from richmap.robots import SETTINGS

if TYPE_CHECKING:
    from envs.task import Task

ORDER = ["method", "lambda", "checkpoint_hash", "episode_seed"]
"""Of the rows, whatever parts they are in."""


def read_episodes(output_dir: Path, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """The episodes that are stored in a folder, each once, with these columns or all; an empty table if none are."""
    return _read(lambda: parts_in(output_dir), columns)


def read_tables(path: Path, task: str | None = None, each_once: bool = True) -> pd.DataFrame:
    """The episodes of a task, or all, in a folder and below it, or in one file; each once, or all rows."""
    keep = (lambda rows: of_task(rows, task)) if task else (lambda rows: rows)
    return _read(lambda: parts_below(path), keep=keep, each_once=each_once)


def read_present(path: Path, task: "Task", each_once: bool = True) -> pd.DataFrame:
    """The episodes of a task's present version, as `read_tables` gives them; how many others there are is printed.

    Raises:
        SettingError: If a column is missing, holds what the task's does not, or is out of its range.
    """
    others, types = 0, column_types(task.outcome)

    def present(rows: pa.Table) -> pa.Table:
        nonlocal others
        kept = rows = of_task(rows, task.name)
        if {"setting", "episode_version"} <= {*rows.column_names}:
            settings = rows["setting"].to_pandas()
            if strange := {*settings} - {*SETTINGS}:
                raise SettingError(f"{path}: setting holds {strange.pop()!r}. Settings: {', '.join(SETTINGS)}.")
            played = settings.map(task.episode_version)
            kept = rows.filter(pa.array((rows["episode_version"].to_pandas() == played).to_numpy()))
            others += len(rows) - len(kept)
        if len(kept) and (missing := types.keys() - SINCE.keys() - {*kept.column_names}):
            raise SettingError(f"{path} is no table of {task.name}: a part lacks {', '.join(sorted(missing))}.")
        check_columns(path, kept, types)
        return kept

    for file in parts_below(path):
        if not has_checksum(file):
            print(f"{file} is not called by its checksum, as our tables are: a damaged value in it may go unseen.")

    def files() -> list[Path]:
        nonlocal others
        others = 0  # Parts are read anew if one of them is merged meanwhile.
        return parts_below(path)

    table = _read(files, keep=present, each_once=each_once)
    for said, wrong in _out_of_range(table, task).items() if len(table) else ():
        if wrong.any():
            row = table[wrong].iloc[0]
            raise SettingError(f"{path}: the row {row_id(row)} ({row_name(row)}) cannot be: {said}.")
    if others:
        print(f"Episodes of other versions of {task.name} than the present one are left out of {path}: {others:,}.")
    return table


def _out_of_range(table: pd.DataFrame, task: "Task") -> dict[str, pd.Series]:
    """Ranges of the columns, and which rows leave them."""
    scores, succeeded = table[[score.name for score in task.scores]], table[task.success].astype(bool)
    return {
        "a score of it is not from 0 to 1": ((scores < 0) | (scores > 1)).any(axis=1),
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


def _read(
    files: Callable[[], list[Path]],
    columns: Sequence[str] | None = None,
    keep: Callable[[pa.Table], pa.Table] = lambda rows: rows,
    each_once: bool = True,
) -> pd.DataFrame:
    asked = None if columns is None else [*dict.fromkeys([*IDENTITY, *columns])]
    while True:
        try:
            tables = [keep(read_part(file, asked)) for file in files()]
            break
        except FileNotFoundError:  # Another process has just merged this part with others.
            continue
    table = to_frame([table for table in tables if len(table)])
    if {*ORDER} <= {*table}:
        table = table.sort_values(ORDER, ignore_index=True, kind="stable")
    if not each_once or not {*IDENTITY} <= {*table}:  # Empty, or no episodes.
        return table
    return table.drop_duplicates(IDENTITY, ignore_index=True)


def store_episodes(output_dir: Path, episodes: Sequence[Episode]) -> Path:
    """Add episodes to the table in a folder; gives the part that they are in. What is there already is not doubled."""
    rows = as_frame([episode.row() for episode in episodes], type(episodes[0].outcome))
    return write_part(output_dir, rows)


def drop_outdated(output_dir: Path, condition: Condition) -> int:
    """Remove the rows that other files of an entry made, at a condition's scale, where an arm has that episode by the
    condition's; gives their number."""
    table, dropped = read_episodes(output_dir), 0
    by_entry = (table.entry_hash == condition.entry_hash) & (table.episode_version == condition.episode_version)
    at_scale = (table["lambda"] == condition.guidance_scale) & (table.method == condition.method)
    scene = [*ARM, "method", "lambda", "episode_seed"]
    made = pd.MultiIndex.from_frame(table.loc[by_entry & at_scale, scene])
    for part in parts_in(output_dir):
        rows = to_frame([read_part(part)])
        others = (rows.entry_hash != condition.entry_hash) | (rows.episode_version != condition.episode_version)
        outdated = others & pd.MultiIndex.from_frame(rows[scene]).isin(made)
        if outdated.any():
            if not outdated.all():
                write_part(output_dir, rows[~outdated])
            part.unlink()
            dropped += int(outdated.sum())
    return dropped


def episodes_of(table: pd.DataFrame, condition: Condition) -> pd.DataFrame:
    """The rows of a condition."""
    if not {*CONDITION} <= {*table}:  # Empty.
        return table[:0]
    row = condition.row()
    return alike(table, {name: row[name] for name in CONDITION})


def stored(output_dir: Path, episodes: pd.DataFrame) -> pd.Series:
    """Whether each of these episodes, given by the columns of `CONDITION` and its seed, is in the table."""
    key = [*CONDITION, "episode_seed"]
    table = read_episodes(output_dir, key)
    if not {*key} <= {*table}:
        return pd.Series(False, index=episodes.index)
    found = episodes.merge(table[key].drop_duplicates(), on=key, how="left", indicator=True)
    return pd.Series(found["_merge"].eq("both").to_numpy(), index=episodes.index)
