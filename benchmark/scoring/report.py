"""What a run prints at its end."""

from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

from benchmark.scoring.scores import by_condition, causes_text, paired, with_interval
from envs.task import Task


def print_report(task: Task, tables: list[pd.DataFrame], output_dir: Path, console: Console) -> None:
    """Scores of each lambda with 95 % intervals, failed episodes by cause, and the paired difference to lambda = 0.

    Args:
        task: What the episodes are of.
        tables: Episodes of each lambda, lambda = 0 first.
        output_dir: Folder of the episodes table.
        console: Where to print.
    """
    rows = [by_condition(table, task).iloc[0] for table in tables]
    scores = Table(title="Percent, with 95 % intervals", title_justify="left")
    for name in ["robot", "setting", "method", "lambda", "n", *task.score_names]:
        scores.add_column(name.replace("_", " "))
    for row in rows:
        intervals = [with_interval(row, name) for name in task.score_names]
        scores.add_row(row.robot, row.setting, row.method, f"{row['lambda']:g}", str(row.n), *intervals)
    console.print(scores)
    for row in rows:
        console.print(f"Failed episodes by cause, lambda {row['lambda']:g}: {causes_text(row.causes)}")
    for table in tables[1:]:
        difference = Table(
            title=f"{table.method.iloc[0]}, lambda {table['lambda'].iloc[0]:g}, minus direct, same episodes, points",
            title_justify="left",
        )
        for name in ["score", "n", "difference", "95 % interval", "exact McNemar p"]:
            difference.add_column(name)
        for _, row in paired(table, tables[0], task).iterrows():
            interval = f"[{100 * row.low:+.1f}, {100 * row.high:+.1f}]"
            p = "" if pd.isna(row.p) else f"{row.p:.3g}"
            difference.add_row(row.score.replace("_", " "), str(row.n), f"{100 * row.difference:+.1f}", interval, p)
        console.print(difference)
    console.print(f"Episodes: {output_dir / 'episodes.parquet'}", soft_wrap=True)
