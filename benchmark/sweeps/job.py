"""A job of a sweep of `benchmark.run`: one combination of settings, in whatever process a launcher of Hydra's gives it.

It is idempotent: what is stored is not run again, so a sweep that was ended anywhere is simply started again. What came
of it goes to the folder `jobs` of the sweep's: `<number>.json`, and its rows beside that.
"""

import json
import multiprocessing
import os
import signal
import threading
import time
import traceback
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from benchmark.settings.config import ORACLE_METHODS, RunConfig
from benchmark.settings.recipe import policy_name
from benchmark.settings.robot_config import SOURCE
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task
from benchmark.settings.typed import typed
from policies.methods import DIRECT
from richmap.progress import number_of

if TYPE_CHECKING:
    import pandas as pd


@dataclass
class JobRecord:
    """What became of a job."""

    name: str
    command: str
    """Which runs it alone."""
    output_dir: str = ""
    """Where its episodes are; empty if its settings are wrong."""
    suite: str = ""
    """On whose conditions it is; empty for one arm."""
    tasks: list[str] = field(default_factory=list)
    """What it did."""
    left_out: bool = False
    """Whether it would guide the source, for which a table of transfer has no row."""
    came_out: str = ""
    """What it came to, in a line; empty if it failed."""
    reason: str = ""
    """Why it failed, in a line; empty if it did not."""
    refused: bool = False
    """Whether that was a wrong setting."""
    trace: str = ""
    """Where it failed, if it was not."""


def run_job(config: DictConfig) -> None:
    """Roll out at the job's lambda alone. Why it failed is written to the sweep's folder; it stops no other."""
    import pandas as pd

    _tie_to_launcher()
    hydra = HydraConfig.get()
    folder, overrides = Path(hydra.sweep.dir), " ".join(hydra.overrides.task)
    record, rows = JobRecord(overrides, f"python -m benchmark.run hydra.mode=RUN {overrides}"), None
    try:
        job = typed(config, RunConfig)
        record.name, record.output_dir, record.suite = job_name(job), job.output_dir, job.suite
        record.left_out = guides_source(job)
        if not record.left_out:
            alone = hydra.runtime.choices["hydra/launcher"] == "basic"  # All jobs in one process, one after another.
            parts = [part for part in job.parts if not job.idle(part.task)] or job.parts
            tables = [_rolled_out(part, job.workers if alone else 1, folder) for part in parts]
            rows, score = pd.concat(tables, ignore_index=True), chosen_task(parts[0].task).ranking[0]
            record.tasks = [part.task for part in parts]
            record.came_out = f"{score} {100 * rows[score].mean():.1f} % of {number_of('episode', len(rows))}"
            record.came_out += "".join(f"; not in {task}: {why}" for task in job.tasks if (why := job.idle(task)))
    except SettingError as error:
        record.reason, record.refused = " ".join(str(error).split()), True
    except Exception as error:
        record.reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        record.trace = "".join(traceback.format_exception(error))
    _write(folder, hydra.job.num, record, rows)


def _rolled_out(job: RunConfig, workers: int, sweep: Path) -> "pd.DataFrame":
    """The job's rows, stored and logged."""
    import pandas as pd

    from benchmark.rollouts.chosen_players import chosen_players
    from benchmark.rollouts.missing_episodes import play_and_store
    from benchmark.sweeps.experiment_log import log_evaluation, log_field
    from richmap.progress import plain_console

    console = plain_console(force_terminal=False)  # Jobs share the terminal.
    players = chosen_players(job, console)
    scale = players[-1].condition.guidance_scale
    players = [player for player in players if player.condition.guidance_scale == scale]
    tables = play_and_store(players, replace(job, workers=workers), plain_console(quiet=True))
    try:
        for player, rows in zip(players, tables, strict=True):
            with suppress(FileExistsError):  # Once in a sweep.
                (sweep / "jobs" / f"logged-{player.condition.field_fingerprint[:16]}").touch(exist_ok=False)
                log_field(job, player, sweep.name)
            log_evaluation(job, player, rows, sweep.name)
    except Exception as error:
        raise SettingError(f"Its episodes are stored, but W&B did not take them ({error}). Run it alone.") from error
    return pd.concat(tables, ignore_index=True)


def _write(sweep: Path, number: int, record: JobRecord, rows: "pd.DataFrame | None") -> None:
    """Write what became of a job, and say it in a line."""
    from richmap.outputs import replacing

    if rows is not None:
        with replacing(sweep / "jobs" / f"{number}.parquet") as path:
            rows.to_parquet(path, index=False)
    with replacing(sweep / "jobs" / f"{number}.json") as path:
        path.write_text(json.dumps(asdict(record), indent=1))
    if record.left_out:
        return
    total = sweep / "jobs" / "total"
    of = f" of {total.read_text()}" if total.exists() else ""
    how = f"failed. {record.reason}" if record.reason else record.came_out
    print(f"Job {number + 1}{of}: {record.name}: {how}", flush=True)


def guides_source(config: RunConfig) -> bool:
    """Whether a job would guide the source arm, which a table of transfer has without guidance only."""
    return not config.conditions and config.robot.name == SOURCE and config.guidance_scale != 0


def job_name(config: RunConfig) -> str:
    """What a job is called."""
    scale = "at the chosen scale" if config.guidance_scale is None else f"{config.guidance_scale:g}"
    unscaled = config.method in (DIRECT, *ORACLE_METHODS.values())
    method = config.method if unscaled else f"{config.method} {scale}"
    if config.conditions:
        return f"{config.suite}, {method}"
    policy = Path(config.policy).name or policy_name(config.recipe, config.seed, config.checkpoint)
    acting = [] if config.method in ORACLE_METHODS.values() else [policy]
    scenes = [f"scenes from {config.seed_start}"] if config.seed_start != RunConfig.seed_start else []
    return ", ".join([config.robot.name, config.setting, method, *acting, *scenes])


@cache
def _tie_to_launcher() -> None:
    """A worker process leaves Ctrl-C to the one that launched it, and ends when that one is gone, however it ended."""
    launcher = multiprocessing.parent_process()
    if launcher is None:  # This is the launching process, or a cluster's job.
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_without, args=(launcher.pid,), daemon=True).start()


def _end_without(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)
