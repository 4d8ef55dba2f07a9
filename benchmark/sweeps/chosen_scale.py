"""Chosen scale."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.episodes.arm import arm_name
from benchmark.scoring.scale_table import CHOSEN_FOR, scale_table
from benchmark.settings.command import SettingError
from benchmark.settings.config import RunConfig
from benchmark.settings.scenes import FIRST_TEST_SEED
from policies.methods import METHODS

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.make_rollout import Stage
    from benchmark.rollouts.rollout import Rollout
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task


def rollouts_of(config: RunConfig, console: "Console") -> "list[Rollout]":
    """What settings ask for: direct transfer, and guidance at their scale, or the one that was chosen, unless it is 0.

    Raises:
        SettingError: If none was chosen, or the policy is not there or cannot be guided.
    """
    from benchmark.artifacts.known_policies import chosen_checkpoint
    from benchmark.rollouts.make_rollout import set_stage

    stage = set_stage(config, chosen_checkpoint(config), console)
    scale = chosen_scale(stage) if config.guidance_scale is None else config.guidance_scale
    return [stage.rollout(each) for each in sorted({0.0, scale})]


def note_on_tuning(config: RunConfig) -> str:
    """What there is to say where a scale that was not chosen on validation episodes meets test episodes; or nothing."""
    if config.seed_start + config.episodes <= FIRST_TEST_SEED or not config.guidance_scale:
        return ""
    return (
        f"These are test scenes, and lambda={config.guidance_scale:g} is given, not chosen: choose scales on "
        "validation scenes (benchmark.scales), and take what was chosen by lambda=null."
    )


def chosen_scale(stage: "Stage") -> float:
    """The scale of a method that was chosen for an arm and a field, in `config.scales_dir`; 0 for direct transfer.

    Raises:
        SettingError: If none was.
    """
    config = stage.config
    if config.method == "direct":
        return 0.0
    direct = stage.rollout(0.0).condition
    arm = tuple(getattr(direct, name) for name in CHOSEN_FOR)
    folder = arm_folder(config.scales_dir, config.recipe, stage.arm)
    chosen = _chosen(folder, stage.task).get((*arm, config.method), {})
    if chosen and (fingerprint := stage.rollout(1.0).condition.field_fingerprint) in chosen:
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


def arm_folder(output_dir: str, recipe: str, arm: "PlacedArm") -> Path:
    """Where the scales of a recipe's policies are, on an arm as it stands."""
    return Path(output_dir) / recipe / arm_name(arm)


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
