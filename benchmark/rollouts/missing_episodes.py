"""What is not stored yet is run, and stored as it comes."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
from rich.console import Console

from benchmark.episodes.parts import merge_parts
from benchmark.episodes.table import drop_outdated, episodes_of, read_episodes, store_episodes
from benchmark.rollouts.players import play_all
from benchmark.settings.config import RunConfig
from richmap.progress import progress_bar

if TYPE_CHECKING:
    from benchmark.episodes.episode import Condition
    from benchmark.rollouts.players import Player


def play_missing(
    players: "Sequence[Player]",
    seeds: range,
    folder_of: "Callable[[Condition], Path]",
    workers: int,
    name: str,
    console: Console,
) -> list[pd.DataFrame]:
    """Rows of each player's episodes with these seeds, under one progress bar: the stored ones, and the rest, played
    and stored group by group.

    Args:
        players: Who plays.
        seeds: Episode seeds, the same for all.
        folder_of: Folder of a condition's table.
        workers: Processes that play.
        name: What the progress bar says.
        console: Where it is.

    Raises:
        SettingError: If a part of a table is damaged.
    """
    conditions = [player.condition for player in players]

    def stored() -> list[pd.DataFrame]:
        tables = {folder: read_episodes(folder) for folder in {folder_of(each) for each in conditions}}
        asked = {folder: t if t.empty else t[t.episode_seed.isin(seeds)] for folder, t in tables.items()}
        return [episodes_of(asked[folder_of(each)], each) for each in conditions]

    missing = [sorted({*seeds} - {*table.get("episode_seed", [])}) for table in stored()]
    total, written = len(conditions) * len(seeds), defaultdict[Path, list[Path]](list)
    with progress_bar(console) as progress:
        task = progress.add_task(name, total=total, completed=total - sum(map(len, missing)))
        for episodes in play_all(zip(players, missing, strict=True), workers):
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
        console.print(f"Rows of these episodes by other files of the method at this scale are dropped: {dropped}.")
    return stored()


def play_and_store(
    players: "Sequence[Player]", config: RunConfig, console: Console, name: str = ""
) -> list[pd.DataFrame]:
    """Rows of what settings of `benchmark.run` ask for of each player; those that are not there are stored in
    `output_dir`. The progress bar says whose they are, or the name."""
    from benchmark.rollouts.field_settings import note_settings

    output_dir, last = Path(config.output_dir), players[-1].condition
    note_settings(output_dir, players, config)
    seeds = range(config.seed_start, config.seed_start + config.episodes)
    name = name or f"{config.suite or last.robot}, {last.method}, lambda {last.guidance_scale:g}"
    return play_missing(players, seeds, lambda _: output_dir, config.workers, name, console)
