"""Stored rows: those that settings choose, and each of them played again."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.rollouts.row_rollout import check_arm, check_version, row_rollout, row_settings
from benchmark.settings.config import ORACLE_METHODS
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.episodes.episode import Episode
    from benchmark.rollouts.arm_oracle import ArmOracle


def chosen_rows(config: ReplayConfig) -> "pd.DataFrame":
    """The rows to replay.

    Raises:
        SettingError: If there is no such row.
    """
    from benchmark.episodes.episode import IDENTITY, Condition, column_types, row_id
    from benchmark.episodes.table import read_tables

    if bool(config.row) == bool(config.random):
        raise SettingError("Which rows? Give row=<id>, or random=<how many>.")
    path = Path(config.table)
    table = read_tables(path, chosen_task(config.task).name)
    if table.empty:
        raise SettingError(
            f"table={path} has no episodes of task={config.task}. Name another task=…, or make some: "
            "python -m benchmark.run"
        )
    if lacking := {*IDENTITY, *column_types(Condition)} - {*table.columns}:
        raise SettingError(f"table={path} lacks the columns {', '.join(sorted(lacking))}: its rows cannot be replayed.")
    if config.random:
        return table.sample(min(config.random, len(table)), random_state=config.seed).sort_values("checkpoint")
    ids = [row_id(row) for row in table[IDENTITY].to_dict("records")]
    rows = table[[each.startswith(config.row) for each in ids]]
    if rows.empty:
        raise SettingError(
            f"table={path} has no row {config.row} of task={config.task}: it has {len(table):,} rows of it, such as "
            f"row={ids[0]}. Rows of another task need task=…"
        )
    return rows


def again(row: Mapping[str, Any], config: ReplayConfig, console: "Console") -> "Episode":
    """A row's episode, again and alone.

    Raises:
        SettingError: If it is of another episode version, or a piece that it was made with is missing.
    """
    seed = row["episode_seed"]
    if row["method"] in ORACLE_METHODS.values():
        (episode,) = row_oracle(row, config).play([seed])
    else:
        (episode,) = row_rollout(row, config, console).play([seed])
    return episode


def row_oracle(row: Mapping[str, Any], config: ReplayConfig) -> "ArmOracle":
    """The scripted oracle of a row."""
    from benchmark.episodes.arm import chosen_arm
    from benchmark.rollouts.chosen_players import oracle_of

    task = chosen_task(config.task)
    check_version(row, task)
    oracle = oracle_of(row["method"], task, chosen_arm(row_settings(row, config, guided=False), task))
    check_arm(row, oracle.arm)
    return oracle
