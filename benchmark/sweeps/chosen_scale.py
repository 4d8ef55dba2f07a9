"""Chosen scale."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.scoring.scale_table import CHOSEN_FOR, scale_table
from benchmark.settings.command import SettingError
from benchmark.settings.config import FIRST_TEST_SEED, RunConfig
from benchmark.settings.task import chosen_task
from policies.methods import METHODS

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.rollout import Rollout
    from envs.task import Task


def rollouts_of(config: RunConfig, console: "Console") -> "list[Rollout]":
    """What settings ask for: direct transfer, and guidance at their scale unless that is 0."""
    from benchmark.artifacts.known_policies import chosen_checkpoint
    from benchmark.rollouts.make_rollout import make_rollout

    config = with_scale(config)
    checkpoint = chosen_checkpoint(config)
    return [make_rollout(config, scale, checkpoint, console) for scale in sorted({0.0, config.guidance_scale or 0.0})]


def note_on_tuning(config: RunConfig) -> str:
    """What there is to say where a scale that was not chosen on validation episodes meets test episodes; or nothing."""
    if config.seed_start + config.episodes <= FIRST_TEST_SEED or not config.guidance_scale:
        return ""
    return (
        f"These are test scenes, and lambda={config.guidance_scale:g} is given, not chosen: choose scales on "
        "validation scenes (benchmark.scales), and take what was chosen by lambda=null."
    )


def with_scale(config: RunConfig) -> RunConfig:
    """The same settings with the scale that was chosen on validation episodes, if they leave it open.

    Raises:
        SettingError: If none was chosen.
    """
    if config.guidance_scale is not None:
        return config
    if config.method == "direct":
        return replace(config, guidance_scale=0.0)
    return replace(config, guidance_scale=chosen_scale(config))


def chosen_scale(config: RunConfig) -> float:
    """The scale of the settings' method that was chosen for their arm and field, in `config.scales_dir`.

    Raises:
        SettingError: If none was.
    """
    from rich.console import Console

    from benchmark.artifacts.known_policies import chosen_checkpoint
    from benchmark.episodes.arm import chosen_arm
    from benchmark.rollouts.make_rollout import guidance_field, make_rollout

    console, direct = Console(quiet=True), replace(config, guidance_scale=0.0)
    condition = make_rollout(direct, 0.0, chosen_checkpoint(direct), console).condition
    arm = tuple(getattr(condition, name) for name in CHOSEN_FOR)
    folder = arm_folder(config.scales_dir, config)
    chosen = _chosen(folder, chosen_task(config.task)).get((*arm, config.method), {})
    if chosen:
        field, _ = guidance_field(METHODS[config.method].field, chosen_arm(config), config, console)
        fingerprint = field.about["fingerprint"] if field else ""
        if fingerprint in chosen:
            return chosen[fingerprint]
    raise SettingError(
        f"lambda=null: {folder} has no scale of method={config.method} for {config.robot.name}, "
        f"{config.setting}{' with the field of these settings' if chosen else ''}. Choose one: python -m "
        f"benchmark.scales robot={config.robot.name} setting={config.setting} recipe={config.recipe} "
        f"methods=[{config.method}] output_dir={config.scales_dir} (and arm.… as here), or give lambda."
    )


@cache
def _chosen(folder: Path, task: "Task") -> dict[tuple, dict[str, float]]:
    """The chosen scales by arm and method, and by field, from the validation episodes of the present version."""
    episodes = read_methods(folder, task, range(50_000, 60_000))
    if episodes.empty:
        return {}
    table = scale_table(episodes, task)
    chosen: dict[tuple, dict[str, float]] = {}
    for row in table[table.chosen].to_dict("records"):
        of_method = chosen.setdefault(tuple(row[name] for name in [*CHOSEN_FOR, "method"]), {})
        of_method[row["field_fingerprint"]] = row["lambda"]
    return chosen


def arm_folder(output_dir: str, config: RunConfig) -> Path:
    """Where the scales of a run's policies are, on its arm as it stands."""
    from benchmark.episodes.arm import arm_name, chosen_arm

    return Path(output_dir) / config.recipe / arm_name(chosen_arm(config))


def read_methods(folder: Path, task: "Task", seeds: range) -> "pd.DataFrame":
    """These episodes in an arm's folder, whatever the method, of the task's present version; an empty table if none
    are."""
    import pandas as pd

    from benchmark.episodes.table import read_episodes

    tables = []
    for method in METHODS:
        table = read_episodes(folder / method)
        if len(table):
            present = table.episode_version == table.setting.map(task.episode_version)
            tables.append(table[present & table.episode_seed.isin(seeds)])
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
