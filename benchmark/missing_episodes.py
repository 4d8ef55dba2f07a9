"""What is not stored yet is run, and stored as it comes."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pandas as pd
from rich.console import Console

from benchmark.progress import progress_bar
from benchmark.results import Condition, Episode, episodes_of, read_episodes, store_episodes


def run_missing(
    conditions: Sequence[Condition],
    seeds: range,
    folder_of: Callable[[Condition], Path],
    run: Callable[[list[list[int]]], Iterable[list[Episode]]],
    name: str,
    console: Console,
) -> list[pd.DataFrame]:
    """Rows of the episodes with these seeds under each condition, under one progress bar of this name.

    Args:
        conditions: What the episodes are run with.
        seeds: Episode seeds, the same for all.
        folder_of: Folder of a condition's table.
        run: Runs for each condition those seeds that its table lacks; gives a few episodes of one condition at a time.
        name: What the progress bar says.
        console: Where it is.
    """

    def stored() -> list[pd.DataFrame]:
        tables = {folder: read_episodes(folder) for folder in {folder_of(each) for each in conditions}}
        asked = {folder: t if t.empty else t[t.episode_seed.isin(seeds)] for folder, t in tables.items()}
        return [episodes_of(asked[folder_of(each)], each) for each in conditions]

    missing = [sorted({*seeds} - {*table.get("episode_seed", [])}) for table in stored()]
    total = len(conditions) * len(seeds)
    with progress_bar(console) as progress:
        task = progress.add_task(name, total=total, completed=total - sum(map(len, missing)))
        for episodes in run(missing):
            store_episodes(folder_of(episodes[0].condition), episodes)
            progress.advance(task, len(episodes))
    return stored()
