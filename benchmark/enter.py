"""Somebody else's entry on the test episodes, by one command; and whether a table that was sent with it can be trusted.

python -m benchmark.enter entry=my_entry
python -m benchmark.enter entry=my_entry suite=full
python -m benchmark.enter entry=my_entry suite=full only=[push-ur5-elbow]
python -m benchmark.enter entry=my_entry suite=full final=true
python -m benchmark.enter entry=their_entry table=their_entry.parquet
"""

import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.episodes.arm import chosen_arms
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.sent_rows import nearest, otherwise, refusals
from benchmark.scoring.ranking import Protocol, protocols_of
from benchmark.settings.command import run_command
from benchmark.settings.config import ConditionConfig, LimitsConfig, RunConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import PAPER_ARMS, RobotConfig
from benchmark.settings.scenes import FIRST_TEST_SEED, VALIDATION
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.suite import suite_conditions, suite_scenes, tasks_of
from benchmark.settings.task import chosen_task
from richmap.outputs import missing_folders, remove_empty, replacing

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.rollout import Rollout
    from envs.task import Task

ALONE = 3
"""Episodes of an entry that are run once more, each alone, before its rows stand."""

SUITE_EPISODES = 50
"""Validation scenes of a condition of a suite."""

SHOWN = 20
"""Most refusals that are shown one by one."""


@dataclass
class EnterConfig:
    """Evaluates somebody else's entry on the test episodes, or on a suite, or checks a table that was sent with it."""

    task: str = "block_push"
    """What is to be done (see benchmark.run)."""
    entry: str = ""
    """Folder of the entry: entry.yaml, and what it names. Its code is run: read it first."""
    table: str = ""
    """A table of episodes that was sent with the entry, a folder or one Parquet file: nothing is stored, the table is
    checked. Empty to evaluate."""
    replays: int | None = None
    """With table=: how many of its rows, drawn at random, are rolled out again; null for all of them (6,000 take about
    20 minutes). If all of n come out alike, fewer than 3 / n of the table are edited, at 95 %."""
    robots: list[str] = field(default_factory=lambda: list(PAPER_ARMS))
    """Arms, as in robots=[ur3,ur5]; the protocol has all four."""
    settings: list[str] = field(default_factory=lambda: ["embodied"])
    """What the arms may do (see benchmark.run): embodied, best or both, as in settings=[embodied,best], by the strict
    protocol (100 episodes of the best policy of each seed), or original by the paper's (50 of three of each)."""
    episodes: int | None = None
    """Number of episodes per arm, setting and policy; null for the protocol's."""
    seed_start: int | None = None
    """Seed of the first episode; null for the protocol's. From 100000 on are test episodes, by which nothing is chosen:
    tune on those from 50000 on, the validation episodes."""
    scale: list[float] = field(default_factory=list)
    """Scales to try instead of the one in entry.yaml, as in scale=[0.25,0.5], on validation episodes alone; empty for
    that one."""
    suite: str = ""
    """Conditions on all of which the entry is rolled out, in place of task, robots and settings (see benchmark.run), on
    50 validation scenes unless final=true: full for its place among all methods, a policy of its own on a suite of its
    task, such as push-v1."""
    only: list[str] = field(default_factory=list)
    """With suite=: some of its conditions by name, as in only=[push-ur5-elbow]; empty for all."""
    final: bool = False
    """With suite=: whether it is rolled out on the suite's test scenes, true or false. A final run with other files of
    the entry than the one before is a further row, as my-entry~2."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of the policies that an entry without a policy of its own guides."""
    output_dir: str = "results/entries"
    """Folder in which a folder of the entry's name gets its episodes and entry.yaml."""
    device: str = "cpu"
    """Where the policy runs: cpu, as those that it is compared with, cuda, or auto (cuda if there is one)."""
    batch_size: int | None = None
    """Rows of the batch in which the policy is evaluated (see benchmark.run); null for the protocol's, as those have
    that it is compared with."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)

    def __post_init__(self) -> None:
        some = self.replays is None or self.replays >= 1
        check_setting(some, "replays", self.replays, "a whole number >= 1, or null for all rows")
        self._begin_suite()
        check_setting(bool(self.robots), "robots", self.robots, f"some of {', '.join(PAPER_ARMS)}")
        protocols = protocols_of(chosen_task(self.task))
        allowed = " or ".join(", ".join(protocol.settings) for protocol in protocols)
        fits = any({*self.settings} <= {*protocol.settings} for protocol in protocols)
        check_setting(bool(self.settings) and fits, "settings", self.settings, allowed)
        self.episodes = self.protocol.episodes if self.episodes is None else self.episodes
        self.seed_start = self.protocol.scenes.start if self.seed_start is None else self.seed_start
        self.batch_size = self.protocol.batch_size if self.batch_size is None else self.batch_size
        check_setting(bool(self.seeds), "seeds", self.seeds, "one or more whole numbers")
        tuned = not self.scale or self.scenes.start < FIRST_TEST_SEED
        check_setting(tuned, "scale", self.scale, "none on test episodes; try scales with seed_start=50000")
        for name in ("robots", "settings", "seeds", "scale", "only"):
            given = getattr(self, name)
            check_setting(len({*given}) == len(given), name, given, "each of them once")
        self.runs("")

    def _begin_suite(self) -> None:
        """Take the scenes that a suite has."""
        if not self.suite:
            check_setting(not self.final, "final", self.final, "false without suite=")
            check_setting(not self.only, "only", self.only, "empty without suite=")
            return
        known = suite_conditions(self.suite)
        check_setting({*self.only} <= {*known}, "only", self.only, f"some of {', '.join(known)}")
        scenes = suite_scenes(self.suite)
        if self.final:
            tests = scenes.start >= FIRST_TEST_SEED
            check_setting(tests, "suite", self.suite, "with final=true, one that has test scenes, such as full")
            given = self.seed_start is None and self.episodes is None
            check_setting(given, "final", self.final, "false with scenes of your own (seed_start, episodes)")
            self.seed_start, self.episodes = scenes.start, len(scenes)
            return
        self.seed_start = VALIDATION.start if self.seed_start is None else self.seed_start
        self.episodes = SUITE_EPISODES if self.episodes is None else self.episodes
        inside = VALIDATION.start <= self.seed_start <= VALIDATION.stop - self.episodes
        validation = f"validation scenes, {VALIDATION[0]} to {VALIDATION[-1]}, without final=true"
        check_setting(inside, "seed_start", self.seed_start, validation)

    @property
    def scenes(self) -> range:
        """Seeds of the episodes."""
        assert self.seed_start is not None and self.episodes is not None
        return range(self.seed_start, self.seed_start + self.episodes)

    @property
    def protocol(self) -> Protocol:
        """The one that counts episodes of these settings."""
        return next(
            protocol for protocol in protocols_of(chosen_task(self.task)) if self.settings[0] in protocol.settings
        )

    @property
    def conditions(self) -> dict[str, ConditionConfig]:
        """Those of the suite that are asked for."""
        return {name: each for name, each in suite_conditions(self.suite).items() if name in (self.only or [name])}

    def runs(self, name: str) -> list[list[RunConfig]]:
        """Settings of the rollouts of what is called so, task by task: of each arm and setting, or of a suite."""
        names = {each.name for each in fields(RunConfig)} & {*vars(self)} - {"output_dir"}
        given = {each: getattr(self, each) for each in names} | {"output_dir": str(Path(self.output_dir, name))}
        if self.suite:
            return [[part] for part in RunConfig(conditions=self.conditions, **given).parts]
        arms = [(robot, setting) for setting in self.settings for robot in self.robots]
        return [[RunConfig(robot=RobotConfig(robot), setting=setting, **given) for robot, setting in arms]]


def main(config: EnterConfig) -> None:
    """Roll the entry out where that is not stored yet. Or, with table=, check what was sent with it: its rows have to
    be those that this tree makes of the entry, none missing, doubled or edited, and all of them, or some, are rolled
    out again. The exit status is 1 if it is refused."""
    check_setting(bool(config.entry), "entry", config.entry, "the folder of an entry, as in entry=my_entry")
    entry = Entry.load(Path(config.entry))
    if config.table and not (Path(config.table).is_dir() or Path(config.table).is_file()):
        raise SettingError(f"table={config.table} is not there. Give a folder of episodes, or a Parquet file.")
    import pandas as pd

    from benchmark.scoring.ceiling import ceilings_file, read_ceilings
    from benchmark.scoring.own_results import show_results
    from benchmark.scoring.suite_table import show_suite
    from richmap.progress import plain_console

    console, tables, made = plain_console(), [], missing_folders(Path(config.output_dir, entry.about.name))
    tasks = tasks_of(config.conditions) if config.suite else [config.task]
    if entry.about.policy and len(tasks) > 1:
        raise SettingError(
            f"entry={entry.folder} has a policy of its own, which is for one task, and suite={config.suite} has "
            f"{' and '.join(tasks)}. Give a suite of its task, push-v1 or buttons-v1, or only= conditions of its task."
        )
    if config.final:
        entry = entry.numbered(final_rows(config, entry))
    entries, ranks = [entry.at(scale) for scale in config.scale] or [entry], (1, 2, 3)
    for runs, direct in zip(config.runs(entry.about.name), config.runs("direct"), strict=True):
        task = chosen_task(runs[0].task)
        checkpoints = entry.checkpoints(
            config.seeds, runs[0].task, ranks[:1] if config.suite or config.protocol.best_only else ranks
        )
        arms = [(run, arm) for run in runs for arm in chosen_arms(run, task)]
        rollouts = [
            each.rollout(run, task, arm, path, console) for each in entries for run, arm in arms for path in checkpoints
        ]
        if config.table:
            check(config, rollouts, console)
        else:
            with _leaving_nothing(Path(runs[0].output_dir), made):
                tables.append(evaluate(entry, rollouts, runs[0], console))
            tables.append(direct_transfer(config, direct, task, console))
    if config.suite and tables:
        ceilings, rows = read_ceilings(ceilings_file(config.suite)), pd.concat(tables, ignore_index=True)
        show_suite(config.suite, config.conditions, rows, ceilings)
    elif tables:
        show_results(pd.concat(tables, ignore_index=True), task, Path(runs[0].output_dir))


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
def _leaving_nothing(folder: Path, made: list[Path]) -> Iterator[None]:
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


if __name__ == "__main__":
    run_command(main, EnterConfig, "enter", goes_on=True)
