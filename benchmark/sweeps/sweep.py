"""Sweeps of `benchmark.run` on Hydra's own sweeper and launchers: where they begin, and what came of their jobs.

python -m benchmark.run -m experiment=transfer robot=ur3 seed=42 lambda=0,2,4
"""

import json
import math
import os
import re
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from decimal import Decimal
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from benchmark.settings.config import WandbConfig
from benchmark.settings.setting import Raised, SettingError
from benchmark.settings.task import chosen_task
from benchmark.settings.typed import typed
from benchmark.sweeps.job import JobRecord
from richmap.outputs import missing_folders, remove_empty

if TYPE_CHECKING:
    from envs.task import Task

MOST_JOBS = 10_000
"""Combinations of a sweep; more are a slip."""
MOST_FAILED = 20
"""How many failed jobs are said one by one."""

_BEGUN: list[tuple[Path, WandbConfig, list[Path]]] = []
"""Folder of the sweep of this process, how it is logged, and the file and the folders that are made for it."""


class SweepStart(Callback):
    """Hydra calls it where a sweep begins (`conf/run.yaml`)."""

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Clear what an earlier sweep left in the same folder, and write down how many jobs there are.

        Raises:
            Raised: From an error in the settings; of any other Hydra would only warn.
        """
        try:
            folder, wandb, jobs = Path(config.hydra.sweep.dir), typed(config.wandb, WandbConfig), count_jobs(config)
        except Exception as error:
            raise Raised from error
        made = [folder / "multirun.yaml", *missing_folders(folder)] if not (folder / "multirun.yaml").exists() else []
        _clear_jobs(folder)
        try:
            (folder / "jobs").mkdir(parents=True, exist_ok=True)
        except OSError:
            return  # Hydra cannot make the folder either, and refuses it; of an error here it would only warn.
        (folder / "jobs" / "total").write_text(str(jobs))
        _BEGUN.append((folder, wandb, made))


def count_jobs(config: DictConfig) -> int:
    """How many combinations a sweep has.

    Raises:
        SettingError: If they are too many, or a setting has a value twice.
    """
    parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
    params = [f"{key}={value}" for key, value in (config.hydra.sweeper.params or {}).items()]
    overrides = parser.parse_overrides([*params, *config.hydra.overrides.task])
    for override in overrides:  # Hydra goes through all of them, also of a setting that is given again.
        if override.is_sweep_override() and len([*islice(override.sweep_string_iterator(), MOST_JOBS + 1)]) > MOST_JOBS:
            raise SettingError(f"The sweep has more than {MOST_JOBS:,} combinations. Give it fewer values.")
    last = {override.key_or_group: override for override in overrides}
    swept = {name: override for name, override in last.items() if override.is_sweep_override()}
    values = {name: [*islice(override.sweep_string_iterator(), MOST_JOBS + 1)] for name, override in swept.items()}
    jobs = math.prod(map(len, values.values()))
    if jobs > MOST_JOBS:
        raise SettingError(f"The sweep has more than {MOST_JOBS:,} combinations. Give it fewer values.")
    for name, given in values.items():
        plain = [_plain(value) for value in given]
        for value, times in Counter(plain).most_common(1):
            if times > 1:
                first = given[plain.index(value)]
                raise SettingError(f"The sweep has {name}={first} {times} times. Give each value once.")
    return jobs


def _plain(value: str) -> str | Decimal:
    """A value without quotes; a number, however it is written, as that number."""
    text = value.strip("'\"")
    return Decimal(text) if re.fullmatch(r"-?(0|[1-9]\d*)(\.\d*)?([eE][-+]?\d+)?", text) else text


def _clear_jobs(folder: Path) -> None:
    """Remove what a sweep wrote down of its jobs, and their folder, if nothing else is in it."""
    with suppress(OSError):  # There is none, or something else is in it.
        for file in [folder / "jobs" / "total", *(folder / "jobs").glob("*.json")]:
            if file.stem.isdigit() or file.name == "total":
                file.unlink(missing_ok=True)
        (folder / "jobs").rmdir()


@contextmanager
def sweeping() -> Iterator[None]:
    """Within it Hydra may begin a sweep. It is said what came of it; one that is refused leaves no folder.

    Raises:
        SettingError: If the settings of all jobs are wrong.
    """
    try:
        yield
        if _BEGUN:
            end_sweep(*_BEGUN[0][:2])
    except (SettingError, HydraException, OmegaConfBaseException):
        for folder, _, made in _BEGUN:
            _clear_jobs(folder)
            for file in made[:1]:
                file.unlink(missing_ok=True)
            remove_empty(made[1:])
        raise
    finally:
        _BEGUN.clear()


def end_sweep(folder: Path, wandb: WandbConfig) -> None:
    """Say what came of the sweep in a folder, and end with status 1 if a job failed.

    Raises:
        SettingError: If the settings of all jobs are wrong.
    """
    records = [
        JobRecord(**json.loads(file.read_text()))
        for file in sorted((folder / "jobs").glob("*.json"), key=lambda file: int(file.stem))
    ]
    if not records:
        raise SettingError(
            "There is nothing to sweep over: a glob() or range() gives no value. See --help for choices."
        )
    failed = [record for record in records if record.reason]
    if failed and all(record.refused for record in records):
        raise SettingError(failed[0].reason)
    left_out = sum(record.left_out for record in records)
    if left_out == len(records):
        raise SettingError("A sweep rolls out the source itself without guidance only: lambda=0.")
    if left_out:
        print(f"Jobs that would guide the source itself are left out: {left_out}.")
    folders = {record.output_dir for record in records if record.output_dir}
    beside = Path(os.path.commonpath(folders)) if folders else folder
    suites = [*dict.fromkeys(record.suite for record in records if record.suite)]
    tasks = [chosen_task(task) for task in dict.fromkeys(chain(*(record.tasks for record in records)))]
    _sum_up(folder, wandb, tasks, suites, beside)
    if failed:
        _say_failed(failed, folder)


def _sum_up(folder: Path, wandb: WandbConfig, tasks: "list[Task]", suites: list[str], beside: Path) -> None:
    """Show and log what the sweep's episodes come to: on its suites, or arm by arm."""
    import pandas as pd

    from benchmark.artifacts.wandb_run import unharmed
    from benchmark.episodes.episode import IDENTITY
    from benchmark.episodes.parts import of_task, read_part, to_frame
    from benchmark.scoring.ceiling import ceilings_file, read_ceilings
    from benchmark.scoring.own_results import show_results
    from benchmark.scoring.suite_table import show_suite
    from benchmark.settings.suite import suite_conditions
    from benchmark.sweeps.experiment_log import log_curves, log_standing

    parts, by_task = [read_part(file) for file in sorted((folder / "jobs").glob("*.parquet"))], []
    for task in tasks:
        tables = [to_frame([rows]) for part in parts if len(rows := of_task(part, task.name))]
        if tables:
            # Direct transfer is the same for all methods.
            by_task.append((task, tables, pd.concat(tables, ignore_index=True).drop_duplicates(IDENTITY)))
    for suite in suites if by_task else ():
        rows = pd.concat([rows for *_, rows in by_task], ignore_index=True)
        of = show_suite(suite, suite_conditions(suite), rows, read_ceilings(ceilings_file(suite)))
        log_standing(wandb, of, folder.name)
    for task, tables, rows in by_task:
        if not suites:
            show_results(rows, task, beside)
        with unharmed():
            log_curves(task, wandb, tables, folder.name)


def _say_failed(failed: list[JobRecord], folder: Path) -> NoReturn:
    """Print which jobs failed and why, as far as there are not too many, and end."""
    for record in failed[:MOST_FAILED]:
        print(f"Failed: {record.name}: {record.reason}")
    if len(failed) > MOST_FAILED:
        print(f"Failed: {len(failed) - MOST_FAILED} more")
    print(f"Whole reasons: {folder / 'jobs'}. The same command goes on where it was.")
    sys.exit(1)
