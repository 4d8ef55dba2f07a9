"""An entry's episodes: rolled out and stored, or those of a table that was sent with it rolled out again."""

import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.episodes.arm import chosen_arms
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.sent_rows import nearest, otherwise, refusals
from benchmark.settings.config import RunConfig
from benchmark.settings.scenes import FIRST_TEST_SEED
from benchmark.settings.setting import SettingError
from benchmark.sweeps.enter_config import EnterConfig
from richmap.outputs import remove_empty, replacing

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.rollout import Rollout
    from envs.task import Task

ALONE = 3
"""Episodes of an entry that are run once more, each alone, before its rows stand."""

SHOWN = 20
"""Most refusals that are shown one by one."""


def final_rows(config: EnterConfig, entry: Entry) -> "pd.DataFrame":
    """Those of the final runs of entries of this name that are stored, or of the one that a table was sent of."""
    from benchmark.episodes.table import read_tables

    folder = Path(config.table or Path(config.output_dir, entry.about.name))
    rows = read_tables(folder)
    if not {"method", "episode_seed", "entry_hash"} <= {*rows}:  # Empty, or no table of episodes.
        return rows.iloc[:0]
    named = rows.method.astype(str).str.fullmatch(rf"{re.escape(entry.about.name)}(~[1-9]\d*)?")
    return rows[named & rows.episode_seed.isin(config.scenes)]


def direct_transfer(
    config: EnterConfig, runs: "Sequence[RunConfig]", task: "Task", console: "Console"
) -> "pd.DataFrame":
    """Episodes of our policies without guidance on the same scenes: those that are published, and on validation scenes
    also those that lack, which are stored in a folder `direct` beside the entry's."""
    import pandas as pd

    from benchmark.artifacts.known_policies import RESULTS, checkpoint_folder, shipped
    from benchmark.episodes.table import episodes_of, read_present
    from benchmark.rollouts.make_rollout import Stage
    from benchmark.rollouts.missing_episodes import play_and_store

    if not shipped(task=task.name):  # Of this task we have no policies.
        return pd.DataFrame()
    checkpoints = [checkpoint_folder(seed, task=task.name) for seed in config.seeds]
    arms = [(run, arm) for run in runs for arm in chosen_arms(run, task)]
    rollouts = [Stage(run, task, arm, path, console).rollout(0.0) for run, arm in arms for path in checkpoints]
    if config.scenes.start < FIRST_TEST_SEED:
        return pd.concat(play_and_store(rollouts, runs[0], console, "direct transfer"))
    published = read_present(RESULTS, task)
    tables = [episodes_of(published, rollout.condition) for rollout in rollouts]
    return pd.concat(
        [table[table.episode_seed.isin(config.scenes)] for table in tables if len(table)] or [pd.DataFrame()]
    )


def evaluate(entry: Entry, rollouts: "Sequence[Rollout]", run: RunConfig, console: "Console") -> "pd.DataFrame":
    """Roll out and store what is missing, and print the scores of each arm, setting and policy; gives the rows."""
    import pandas as pd

    from benchmark.episodes.parts import write_part
    from benchmark.episodes.table import read_episodes
    from benchmark.rollouts.missing_episodes import play_and_store
    from benchmark.rollouts.players import play_all
    from benchmark.scoring.scores import by_condition, with_interval

    folder = Path(run.output_dir)
    if folder.resolve().is_relative_to(entry.folder.resolve()):
        raise SettingError(
            f"The episodes of entry={entry.folder} would go to {folder}, where they would become part of the entry. "
            "Keep the entry elsewhere, or give another output_dir."
        )
    _check_author(entry, folder)
    with replacing(folder / "entry.yaml") as path:
        shutil.copyfile(entry.folder / "entry.yaml", path)
    tables = play_and_store(rollouts, run, console, entry.about.name)
    scales = [*{rollout.condition.guidance_scale for rollout in rollouts}]
    for row in () if run.suite else (by_condition(table, rollouts[0].task).iloc[0] for table in tables):
        scores = "\n  ".join(f"{name} {with_interval(row, name)}" for name in rollouts[0].task.score_names)
        named = f"{row.robot}, {row.setting}, {row.checkpoint}" + (f", scale {row['lambda']:g}" if scales[1:] else "")
        console.print(f"{named}, n = {row.n}\n  {scores}", soft_wrap=True)
    made = pd.concat(tables)
    some = made.sample(min(ALONE, len(made)), random_state=secrets.randbits(32))  # Nobody knows beforehand which.
    each_alone = ((rollouts[nearest(row, rollouts)[0]], [row["episode_seed"]]) for row in some.to_dict("records"))
    again = chain.from_iterable(play_all(each_alone, workers=1))
    if refused := list(otherwise(some, again)):
        stored = read_episodes(folder)
        others = stored[(stored.entry_hash != entry.files_hash) | (stored.method != entry.method)]
        (folder / "episodes").rename(folder / f"refused-{time.time_ns()}")
        if len(others):  # Of an earlier final run, which stays.
            write_part(folder, others)
        raise SettingError(
            f"{refused[0]} An episode has to come out alike when it is run alone: the entry is random by itself, or "
            f"keeps something from one batch to the next. Its rows are in {folder}, under refused-…."
        )
    console.print(f"Episodes: {folder / 'episodes'}", soft_wrap=True)
    return made


@contextmanager
def leaving_nothing(folder: Path, made: list[Path]) -> Iterator[None]:
    """Remove a folder for episodes that is refused without one, with those above it, as far as they were made."""
    try:
        yield
    except SettingError:
        remove_empty([folder / "episodes"])
        if made and {file.name for file in folder.glob("*")} == {"entry.yaml"}:
            (folder / "entry.yaml").unlink()
            remove_empty([folder, *made])
        raise


def _check_author(entry: Entry, folder: Path) -> None:
    """Nobody's rows are dropped for somebody else's entry of the same name."""
    there = folder / "entry.yaml"
    if there.is_file() and (author := Entry.load(folder).about.author) != entry.about.author:
        raise SettingError(
            f"{folder} holds the entry {entry.about.name} of {author or 'nobody'}. Give yours another name, or move "
            "that folder away."
        )


def check(config: EnterConfig, rollouts: "Sequence[Rollout]", console: "Console") -> None:
    """Say why the table is refused, and end with status 1, or that it is accepted."""
    import numpy as np

    from benchmark.episodes.checked_rows import read_checked
    from benchmark.rollouts.players import play_all

    table = read_checked(Path(config.table), rollouts[0].task)
    refused = list(refusals(table, rollouts, config.scenes))
    if not refused:
        chance = np.random.default_rng()  # The operating system's: the entry's code could seed NumPy's own.
        sample = table if config.replays is None else table.sample(min(config.replays, len(table)), random_state=chance)
        seeds: dict[Rollout, list[int]] = {}
        for row in sample.to_dict("records"):
            seeds.setdefault(rollouts[nearest(row, rollouts)[0]], []).append(row["episode_seed"])
        again = chain.from_iterable(play_all(seeds.items(), config.workers))
        refused = list(otherwise(sample, again))
    for reason in refused[:SHOWN]:
        console.print(f"Refused: {reason}", soft_wrap=True, highlight=False)
    if refused:
        more = f" ({len(refused)} reasons in all)" if len(refused) > SHOWN else ""
        way_out = f"Make its rows here: python -m benchmark.enter entry={config.entry}"
        console.print(f"{config.table} is refused{more}. {way_out}", soft_wrap=True)
        sys.exit(1)
    some = 3 < len(sample) < len(table)
    limit = f"; at 95 %, fewer than {3 / len(sample):.0%} of its rows can be edited" if some else ""
    accepted = f"{config.table} is accepted: {len(table)} rows, of which {len(sample)} replay to the last bit{limit}."
    console.print(accepted, soft_wrap=True)
