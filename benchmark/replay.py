"""Replays stored rows, each alone, and says for each column whether it is bit-equal.

python -m benchmark.replay table=results row=<row_hash>
python -m benchmark.replay table=results/entries/mine entry=mine random=20
"""

import sys
from collections.abc import Mapping
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.episodes.table import NOT_REPLAYED, differences
from benchmark.rollouts.rollout import alone
from benchmark.rollouts.row_rollout import row_rollout, stored_otherwise
from benchmark.settings.command import SettingError, check_setting, run_command
from benchmark.settings.config import ORACLE_METHODS
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.episodes.table import Episode
    from envs.task import Task


def main(config: ReplayConfig) -> None:
    """Replay the chosen rows; of several, those whose pieces are on this machine. The exit status is 1 if a column of
    one is not bit-equal, one was edited, or none could be replayed."""
    from rich.console import Console

    from benchmark.episodes.table import row_hash, row_name

    console, equal, missing = Console(), True, 0
    rows = chosen_rows(config).to_dict("records")
    for row in rows:
        console.print(f"{row_name(row)} ({row['row_hash']})", soft_wrap=True, highlight=False)
        if row_hash(row) != row["row_hash"]:
            console.print("  edited: its row_hash does not fit, so it is not as it was stored.", soft_wrap=True)
            equal = False
        try:
            episode = again(row, config, console)
        except SettingError as error:
            if len(rows) == 1:
                raise
            console.print(f"  not replayed: {error}", soft_wrap=True, highlight=False)
            missing += 1
            continue
        differing = differences(row, episode)
        compared = episode.row().keys() - NOT_REPLAYED
        same = [name for name in row if name in compared - differing.keys()]
        code = differing.pop("code_version", None)
        console.print(f"  bit-equal: {', '.join(same)}", soft_wrap=True, highlight=False)
        for name, (stored, replayed) in differing.items():
            console.print(f"  differs: {name}, {_apart(stored, replayed)}", soft_wrap=True, highlight=False)
        if differing and (how := stored_otherwise(row)):
            console.print(f"  {how}", soft_wrap=True, highlight=False)
        if code:
            console.print(
                f"  The row is of code {code[0]} (commit {row['commit'] or 'unknown'}) and was replayed by {code[1]}: "
                + ("that changed nothing of it." if not differing else "that may be why. Check its commit out."),
                soft_wrap=True,
                highlight=False,
            )
        equal &= not differing
    if missing:
        print(f"{missing} of {len(rows)} rows were not replayed, since something that they were made with is not here.")
    if missing == len(rows):
        sys.exit(1)
    if not equal:
        print(
            "Not bit-equal, or edited. A row replays to the last bit where numbers are rounded as where it was stored."
        )
        sys.exit(1)


def chosen_rows(config: ReplayConfig) -> "pd.DataFrame":
    """The rows to replay.

    Raises:
        SettingError: If there is no such row.
    """
    import pandas as pd

    from benchmark.episodes.table import read_table

    chosen = (config.row != "") + (config.number >= 0) + (config.random > 0)
    check_setting(chosen == 1, "row", config.row, "exactly one of row=<row_hash>, number=<row> and random=<rows>")
    path = Path(config.table)
    files = sorted(path.rglob("episodes.parquet")) if path.is_dir() else [path]
    tables = [table for table in map(read_table, files) if "row_hash" in table]
    if not tables:
        raise SettingError(
            f"table={path} has no episodes whose rows have a row_hash. Make some: python -m benchmark.run"
        )
    if config.number >= 0 and len(files) > 1:
        raise SettingError(f"number={config.number} needs one table. Under {path} there are {len(files)}.")
    table = pd.concat(tables, ignore_index=True)
    if config.row:
        rows = table[table.row_hash.str.startswith(config.row, na=False)]
    elif config.number >= 0:
        rows = table.iloc[config.number : config.number + 1]
    else:
        rows = drawn_rows(table, config).sort_values("checkpoint")
    if rows.empty:
        raise SettingError(
            f"table={path} has no row {config.row or config.number}: it has {len(table)} rows, such as "
            f"row={table.row_hash.iloc[0]}."
        )
    return rows


def drawn_rows(table: "pd.DataFrame", config: ReplayConfig) -> "pd.DataFrame":
    """Rows drawn at random from those that were rounded as here; says how many others there are.

    Raises:
        SettingError: If all were rounded otherwise.
    """
    from benchmark.episodes.arithmetic import arithmetic

    here = table[table.arithmetic.eq(arithmetic()).fillna(False)] if "arithmetic" in table else table[:0]
    if here.empty:
        raise SettingError(
            f"table={config.table} has no row that was rounded as here (arithmetic={arithmetic()}), so that none need "
            f"come out alike. One of its {len(table):,} rows all the same: row={table.row_hash.iloc[0]}"
        )
    if len(here) < len(table):
        print(
            f"Drawn from the {len(here):,} of {len(table):,} rows that were rounded as here, arithmetic={arithmetic()}."
        )
    return here.sample(min(config.random, len(here)), random_state=config.seed)


def _apart(stored: Any, replayed: Any) -> str:
    """Both values; of a path, those where the two part."""
    if not (isinstance(stored, list) and isinstance(replayed, list)):
        return f"stored {stored}, replayed {replayed}"
    pairs = zip_longest(stored, replayed)
    step, (was, now) = next((step, pair) for step, pair in enumerate(pairs) if pair[0] != pair[1])
    return f"from entry {step} on: stored {was}, replayed {now}; {len(stored)} and {len(replayed)} entries"


def again(row: Mapping[str, Any], config: ReplayConfig, console: "Console") -> "Episode":
    """A row's episode, again and alone.

    Raises:
        SettingError: If a piece that it was made with is missing.
    """
    if row["method"] in ORACLE_METHODS.values():
        return oracle_alone(row, chosen_task(config.task))
    return alone(row_rollout(row, config, console), row["episode_seed"])


def oracle_alone(row: Mapping[str, Any], task: "Task") -> "Episode":
    """The episode of a scripted oracle."""
    from benchmark.episodes.arm import arm_of
    from benchmark.episodes.table import Episode
    from benchmark.rollouts.arm_oracle import ArmOracle, play_chunk

    (oracle,) = [name for name, method in ORACLE_METHODS.items() if method == row["method"]]
    player, seed = ArmOracle(task, arm_of(row), oracle), row["episode_seed"]
    (outcome,) = play_chunk((player, (seed,)))
    return Episode(player.condition, seed, 0, outcome)


if __name__ == "__main__":
    run_command(main, ReplayConfig, "replay")
