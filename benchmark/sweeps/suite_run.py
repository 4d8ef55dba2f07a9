"""A method on all conditions of a suite: what is not stored yet is rolled out, by policies or by a scripted oracle."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.config import ORACLE_METHODS, ConditionConfig, RunConfig
from benchmark.settings.scenes import TABLES
from benchmark.settings.suite import suite_runs
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.rollout import Rollout
    from envs.task import Task


def suite_rows(config: RunConfig, console: "Console", with_direct: bool) -> "pd.DataFrame":
    """Rows of the settings' method on their suite, and of direct transfer beside it if asked for.

    Raises:
        SettingError: If a policy is not there, an arm cannot stand so, or no scale was chosen.
    """
    import pandas as pd

    from benchmark.rollouts.missing_episodes import run_and_store_all

    if config.method in ORACLE_METHODS.values():
        return pd.concat(_oracle_tables(config, console), ignore_index=True)
    rollouts = suite_rollouts(config, console)
    scale = rollouts[-1].condition.guidance_scale
    asked = [each for each in rollouts if with_direct or each.condition.guidance_scale == scale]
    tables = run_and_store_all(asked, config, f"{config.suite}, {config.method}", console)
    return pd.concat(tables, ignore_index=True)


def suite_rollouts(config: RunConfig, console: "Console") -> "list[Rollout]":
    """Direct transfer and the method at its scale, condition by condition, with the policy of each training seed."""
    from benchmark.sweeps.chosen_scale import rollouts_of

    runs = [replace(run, seed=seed) for run in suite_runs(config).values() for seed in config.seeds]
    rollouts = [rollout for run in runs for rollout in rollouts_of(run, console)]
    return sorted(rollouts, key=lambda rollout: rollout.condition.guidance_scale)


def _oracle_tables(config: RunConfig, console: "Console") -> "list[pd.DataFrame]":
    from benchmark.episodes.arm import chosen_arm
    from benchmark.rollouts.arm_oracle import ArmOracle, play_missing

    task = chosen_task(config.task)
    (oracle,) = [oracle for oracle, method in ORACLE_METHODS.items() if method == config.method]
    players = [ArmOracle(task, chosen_arm(run, task), oracle) for run in suite_runs(config).values()]
    seeds, name = range(config.seed_start, config.seed_start + config.episodes), f"{config.suite}, {config.method}"
    return play_missing(players, seeds, Path(config.output_dir), config.workers, name, console)


def show_suite(suite: str, conditions: dict[str, ConditionConfig], rows: "pd.DataFrame", task: "Task") -> None:
    """Print what rows come to on a suite, on one block of scenes: those for tables, or where none are, the others."""
    from benchmark.scoring.ceiling import ceilings_file, read_ceilings
    from benchmark.scoring.suite_table import by_condition, shares, suite_table, suite_text

    in_block = rows.episode_seed.isin(TABLES)
    rows = rows[in_block] if in_block.any() else rows
    ceilings, tables = read_ceilings(ceilings_file(suite)), by_condition(rows, conditions, task)
    shown = conditions, ceilings, task
    print(suite_text(suite_table(tables, *shown), shares(tables, *shown), task))
