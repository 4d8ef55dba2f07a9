"""What a run prints at its end."""

from pathlib import Path

import pandas as pd

from benchmark.scoring.scores import by_condition, causes_text, difference_text, paired, with_interval
from benchmark.scoring.text_table import text_table
from envs.task import Task
from richmap.progress import number_of


def print_report(task: Task, tables: list[pd.DataFrame], output_dir: Path) -> None:
    """Scores of each lambda with 95 % intervals, failed episodes by cause, and the paired difference to lambda = 0.

    Args:
        task: What the episodes are of.
        tables: Episodes of each lambda, lambda = 0 first.
        output_dir: Folder of the episodes table.
    """
    rows = [by_condition(table, task).iloc[0] for table in tables]
    names = [f"{row.method}, lambda {row['lambda']:g}" if row["lambda"] else row.method for row in rows]
    print(f"{rows[0].robot}, {rows[0].setting}, {number_of('episode', int(rows[0].n))}. Percent, with 95 % intervals:")
    lines = [[_spaced(score), *(with_interval(row, score) for row in rows)] for score in task.score_names]
    print(text_table(["", *names], lines))
    for name, row in zip(names, rows, strict=True):
        print(f"Failed episodes by cause, {name}: {causes_text(row.causes)}")
    for name, table in zip(names[1:], tables[1:], strict=True):
        print(f"{name}, minus direct on the same episodes, in points:")
        compared = paired(table, tables[0], task).rename(columns={"low": "difference_low", "high": "difference_high"})
        lines = [
            [_spaced(row.score), difference_text(row), "" if pd.isna(row.p) else f"{row.p:.3g}"]
            for _, row in compared.iterrows()
        ]
        print(text_table(["", "difference", "exact McNemar p"], lines))
    print(f"Episodes: {output_dir}")


def _spaced(name: str) -> str:
    return name.replace("_", " ")
