"""What is not stored yet is run, and stored as it comes."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
from rich.console import Console

from benchmark.episodes.episode import Condition, Episode
from benchmark.episodes.parts import merge_parts
from benchmark.episodes.table import drop_outdated, episodes_of, read_episodes, store_episodes
from benchmark.settings.config import RunConfig
from richmap.progress import progress_bar

if TYPE_CHECKING:
    from benchmark.rollouts.rollout import Rollout


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

    Raises:
        SettingError: If a part of a table is damaged.
    """

    def stored() -> list[pd.DataFrame]:
        tables = {folder: read_episodes(folder) for folder in {folder_of(each) for each in conditions}}
        asked = {folder: t if t.empty else t[t.episode_seed.isin(seeds)] for folder, t in tables.items()}
        return [episodes_of(asked[folder_of(each)], each) for each in conditions]

    missing = [sorted({*seeds} - {*table.get("episode_seed", [])}) for table in stored()]
    total, written = len(conditions) * len(seeds), defaultdict[Path, list[Path]](list)
    with progress_bar(console) as progress:
        task = progress.add_task(name, total=total, completed=total - sum(map(len, missing)))
        for episodes in run(missing):
            folder = folder_of(episodes[0].condition)
            written[folder].append(store_episodes(folder, episodes))
            progress.advance(task, len(episodes))
    for parts in written.values():
        merge_parts(parts)
    dropped = 0
    for condition in conditions:
        if condition.entry_hash:
            dropped += drop_outdated(folder_of(condition), condition)
    if dropped:
        console.print(f"{dropped} rows of these episodes, by other files of the method at this scale, are dropped.")
    return stored()


def run_and_store(rollout: "Rollout", config: RunConfig, console: Console) -> pd.DataFrame:
    """Rows of all episodes of a rollout: the stored ones, and the rest run and stored batch by batch."""
    condition = rollout.condition
    name = f"{condition.robot}, {condition.method}, lambda {condition.guidance_scale:g}"
    (table,) = run_and_store_all([rollout], config, name, console)
    return table


def run_and_store_all(
    rollouts: "Sequence[Rollout]", config: RunConfig, name: str, console: Console
) -> list[pd.DataFrame]:
    """The same for several rollouts, one after another under one progress bar of this name."""
    from benchmark.rollouts.field_settings import note_settings
    from benchmark.rollouts.rollout import roll_out_all

    output_dir = Path(config.output_dir)
    note_settings(output_dir, rollouts, config)
    return run_missing(
        [rollout.condition for rollout in rollouts],
        range(config.seed_start, config.seed_start + config.episodes),
        lambda _: output_dir,
        lambda missing: roll_out_all(zip(rollouts, missing, strict=True), config.workers),
        name,
        console,
    )
