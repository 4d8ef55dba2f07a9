"""Sweeps of `benchmark.run`: which of their jobs are missing, what a job does, and how far the whole is.

python -m benchmark.run -m experiment=transfer robot=ur3 seed=42 lambda=0,2,4
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from hashlib import sha256
from itertools import batched
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
from hydra.core.hydra_config import HydraConfig
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig
from rich.console import Console

from benchmark.artifacts.known_policies import chosen_checkpoint
from benchmark.artifacts.outputs import replacing
from benchmark.artifacts.progress import progress_bar
from benchmark.artifacts.wandb_run import unharmed
from benchmark.episodes.table import CONDITION, check_unedited, episodes_of, read_episodes, stored
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.missing_episodes import run_and_store
from benchmark.settings.command import SettingError, typed
from benchmark.settings.config import SOURCE, RunConfig
from benchmark.settings.recipe import policy_name
from benchmark.sweeps.chosen_scale import with_scale
from benchmark.sweeps.experiment_log import log_curves, log_evaluation, log_field

if TYPE_CHECKING:
    from benchmark.rollouts.rollout import Rollout

LOOK_EVERY = 20.0
"""How often the tables are counted, in [s]."""

MOST_FAILED = 20
"""How many failed jobs are printed one by one."""

RELAUNCHES = 5
"""How often workers that were killed are started again without any of them having stored an episode in between."""

QUIET = Console(quiet=True)
"""Of jobs, which share the terminal."""


@dataclass(frozen=True)
class Job:
    """One condition of a sweep, and its episodes."""

    overrides: tuple[str, ...]
    """What tells it from the defaults, as on the command line."""
    config: RunConfig = field(compare=False)
    rollout: "Rollout"
    seeds: range
    output_dir: Path

    @property
    def name(self) -> str:
        """What it is called where it failed."""
        return job_name(self.config)

    def episodes(self) -> pd.DataFrame:
        """What identifies each episode, one per row."""
        row = self.rollout.condition.row()
        return pd.DataFrame({"episode_seed": self.seeds} | {name: row[name] for name in CONDITION})


def run_sweep(composed: list[tuple[list[str], DictConfig]], launcher: Launcher, folder: Path) -> None:
    """Launch the jobs whose episodes are not stored, show how far all of them are, and say what failed.

    Ends the program with status 1 if something is missing in the end.

    Args:
        composed: Overrides and settings of each job.
        launcher: What runs jobs, here or on a cluster.
        folder: Of this sweep; what failed is in its folder `failed`.

    Raises:
        SettingError: If the settings of all jobs are wrong in themselves, nothing is left to sweep, or a stored row was
            edited.
    """
    console = Console()
    failed: dict[str, str] = {}
    asked = typed_jobs(composed, failed)
    configs = {overrides: config for overrides, config in asked.items() if not guides_source(config)}
    if not configs:
        raise SettingError(f"A sweep rolls out {SOURCE}, the source itself, without guidance only: lambda=0.")
    if left_out := len(asked) - len(configs):
        console.print(f"{left_out} jobs would guide {SOURCE}, the source itself, and are left out.", soft_wrap=True)
    jobs: dict[tuple, Job] = {}
    for overrides, config in configs.items():
        try:
            job = prepare(overrides, config, console)
            key = job.rollout.condition, job.seeds, job.output_dir
            jobs.setdefault(key, job)  # lambda=0 is the same for every method.
        except Exception as error:
            note_failure(folder, config, overrides, error)
            failed[job_name(config)] = reason(error)
    say_failed(failed, console)
    missing = unfinished(jobs.values())
    console.print(
        f"{len(jobs)} jobs of {sum(len(job.seeds) for job in jobs.values())} episodes: {len(jobs) - len(missing)} are "
        f"stored, {len(missing)} to run. {len(failed)} cannot run.",
        soft_wrap=True,
    )
    if missing:
        for job in missing:
            with unharmed():
                log_field(job.config, job.rollout, folder.name)
        with progress(jobs.values(), folder, console):
            launch(missing, launcher, console)
    ended = {job.name: failure_file(folder, job.name) for job in missing}
    failed |= {name: file.read_text().splitlines()[1] for name, file in ended.items() if file.exists()}
    failed = {
        job.name: "Not stored whole: it was stopped before its end, or still runs on a cluster."
        for job in unfinished(missing)
    } | failed
    say_failed(failed, console)
    rows = [*rows_of(jobs.values())]
    with unharmed():
        log_curves(next(iter(configs.values())).wandb, rows, folder.name)
    if failed:
        console.print(f"Whole reasons: {folder / 'failed'}. The same command goes on where it was.", soft_wrap=True)
        sys.exit(1)
    console.print(f"All is stored: {', '.join(sorted({str(job.output_dir) for job in jobs.values()}))}", soft_wrap=True)


def typed_jobs(
    composed: list[tuple[list[str], DictConfig]], failed: dict[str, str]
) -> dict[tuple[str, ...], RunConfig]:
    """Settings of the jobs by their overrides; why one has none is added to `failed`.

    Raises:
        SettingError: If none has.
    """
    configs = {}
    for overrides, config in composed:
        try:
            configs[tuple(overrides)] = typed(config, RunConfig)
        except SettingError as error:
            if len(failed) + 1 == len(composed):
                raise
            failed[" ".join(overrides)] = reason(error)
    return configs


def launch(missing: dict[Job, int], launcher: Launcher, console: Console) -> None:
    """Run jobs; where a worker was killed, those that are left again, the first one last: it may be what kills them.

    Args:
        missing: Jobs, and how many of their episodes are not stored.
        launcher: What runs them. Submitit's local one, which starts all that it is given at once, is given as many as
            there are workers.
        console: Where to print.
    """
    idle, local = 0, type(launcher).__name__ == "LocalLauncher"  # Hydra loads its plugins as modules of its own.
    while True:
        at_once = next(iter(missing)).config.workers if local else len(missing)
        try:
            for number, jobs in enumerate(batched(missing, at_once)):
                launcher.launch([job.overrides for job in jobs], initial_job_idx=number * at_once)
            return
        except Exception as error:
            console.print(f"The launcher ended early. {reason(error)}", soft_wrap=True, markup=False)
            before, missing = missing, unfinished(missing)
            idle = idle + 1 if sum(missing.values()) == sum(before.values()) else 0
            if not missing or not (local or isinstance(error, BrokenProcessPool)) or idle > RELAUNCHES:
                return  # A cluster's other jobs go on.
            first, *others = missing.items()
            missing = dict([*others, first])


def say_failed(failed: dict[str, str], console: Console) -> None:
    """Print which jobs failed and why, as far as there are not too many."""
    for name, why in [*failed.items()][:MOST_FAILED]:
        console.print(f"Failed: {name}: {why}", soft_wrap=True, markup=False)
    if len(failed) > MOST_FAILED:
        console.print(f"Failed: {len(failed) - MOST_FAILED} more")


def guides_source(config: RunConfig) -> bool:
    """Whether a job would guide the source arm, which a table of transfer has without guidance only."""
    return config.robot.name == SOURCE and config.method != "direct" and config.guidance_scale != 0


def prepare(overrides: tuple[str, ...], config: RunConfig, console: Console) -> Job:
    """What a job is to roll out; a field that is not in the cache is built."""
    config = with_scale(config)
    rollout = make_rollout(config, config.guidance_scale, chosen_checkpoint(config), console)
    seeds = range(config.seed_start, config.seed_start + config.episodes)
    return Job(overrides, config, rollout, seeds, Path(config.output_dir))


def unfinished(jobs: Iterable[Job]) -> dict[Job, int]:
    """The jobs of which episodes are not stored, and of how many; each table is read once."""
    missing, order = {}, list(jobs)
    for output_dir in {job.output_dir for job in order}:
        here = [job for job in order if job.output_dir == output_dir]
        is_stored = stored(output_dir, pd.concat([job.episodes() for job in here], keys=range(len(here))))
        missing |= {job: int((~is_stored[number]).sum()) for number, job in enumerate(here)}
    return {job: missing[job] for job in order if missing[job]}


def rows_of(jobs: Iterable[Job]) -> Iterator[pd.DataFrame]:
    """The stored episodes of each job of which there are any.

    Raises:
        SettingError: If one was edited.
    """
    tables = {output_dir: read_episodes(output_dir) for output_dir in {job.output_dir for job in jobs}}
    for job in jobs:
        if len(rows := episodes_of(tables[job.output_dir], job.rollout.condition)):
            asked = rows[rows.episode_seed.isin(job.seeds)]
            check_unedited(asked, job.output_dir / "episodes.parquet")
            yield asked


def run_job(config: DictConfig) -> None:
    """A job of a sweep: its own lambda only, in this process. Why it failed is written to the sweep's folder."""
    _tie_to_launcher()
    job, hydra = typed(config, RunConfig), HydraConfig.get()
    folder, overrides = Path(hydra.sweep.dir), hydra.overrides.task
    try:
        job = replace(with_scale(job), workers=1)
        failure_file(folder, job_name(job)).unlink(missing_ok=True)  # It is tried again.
        rollout = make_rollout(job, job.guidance_scale, chosen_checkpoint(job), QUIET)
        episodes = run_and_store(rollout, job, QUIET)
        try:
            log_evaluation(job, rollout, episodes, folder.name)
        except Exception as error:
            alone = f"python -m benchmark.run hydra.mode=RUN {' '.join(overrides)}"  # An experiment would sweep again.
            raise SettingError(
                f"Its episodes are stored, but W&B did not take them ({error}). Log them: {alone}"
            ) from error
    except Exception as error:
        note_failure(folder, job, overrides, error)


@cache
def _tie_to_launcher() -> None:
    """A worker process leaves Ctrl-C to the one that launched it, and ends when that one is gone, however it ended."""
    launcher = multiprocessing.parent_process()
    if launcher is None:  # This is the launching process, or a cluster's job.
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_without, args=(launcher.pid,), daemon=True).start()


def _end_without(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


def job_name(config: RunConfig) -> str:
    """What a job is called, also in file names."""
    scale = "chosen" if config.guidance_scale is None else f"{config.guidance_scale:g}"
    policy = Path(config.policy).name or policy_name(config.recipe, config.seed, config.checkpoint)
    told_apart = sha256(repr(replace(config, workers=1)).encode()).hexdigest()[:6]  # by settings that are not in it
    return f"{config.robot.name}-{config.setting}-{config.method}-{scale}-{policy}-{told_apart}"


def failure_file(folder: Path, name: str) -> Path:
    """Where the reason is, if a job failed: the job, the error, where it was raised."""
    return folder / "failed" / f"{name}.txt"


def note_failure(folder: Path, config: RunConfig, overrides: tuple[str, ...], error: Exception) -> None:
    """Write why a job failed."""
    with replacing(failure_file(folder, job_name(config))) as path:
        trace = "".join(traceback.format_exception(error))
        path.write_text(f"python -m benchmark.run -m {' '.join(overrides)}\n{reason(error)}\n\n{trace}")


def reason(error: Exception) -> str:
    """An error in one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, SettingError) else f"{type(error).__name__}: {text}"


@contextmanager
def progress(jobs: Iterable[Job], folder: Path, console: Console) -> Iterator[None]:
    """Show how many episodes of these jobs are stored, wherever they run, and how long the rest will take."""
    jobs, over = list(jobs), threading.Event()
    total = sum(len(job.seeds) for job in jobs)

    def count() -> int:
        return total - sum(unfinished(jobs).values())

    def watch() -> None:
        with progress_bar(console, period=3600) as bar:
            task = bar.add_task("Sweep", total=total, completed=count())
            while not over.wait(LOOK_EVERY):
                failed = len(list(folder.glob("failed/*")))
                bar.update(task, completed=count(), description=f"Sweep, {failed} jobs failed" if failed else "Sweep")
            bar.update(task, completed=count())

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
