"""The scale of a method that was chosen on validation scenes, and what stands beside it."""

from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.episodes.arm import arm_name
from benchmark.settings.chosen_scales import read_scales
from benchmark.settings.command import SettingError
from benchmark.settings.config import RunConfig
from benchmark.settings.scenes import FIRST_TEST_SEED
from policies.methods import METHODS

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.rollouts.make_rollout import Stage
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task


def note_on_tuning(config: RunConfig) -> str:
    """What there is to say where a scale that was not chosen on validation episodes meets test episodes; or nothing."""
    if config.seed_start + config.episodes <= FIRST_TEST_SEED or not config.guidance_scale:
        return ""
    return (
        f"These are test scenes, and lambda={config.guidance_scale:g} is given, not chosen: choose scales on "
        "validation scenes (benchmark.choose_scales), and take what was chosen by lambda=null."
    )


def chosen_scale(stage: "Stage") -> float:
    """The one scale of a method that was chosen for its task, in `config.scales_dir`; 0 for direct transfer.

    Raises:
        SettingError: If none was.
    """
    config = stage.config
    if config.method == "direct":
        return 0.0
    if stage.entry:
        if stage.entry.default_scale is None:
            raise SettingError(f"lambda=null: {config.method} names no default_scale. Give it one, or give lambda.")
        return stage.entry.default_scale
    file = scales_file(config.scales_dir, stage.task)
    if (chosen := read_scales(file).get(config.method)) is not None:
        return float(chosen["scale"])
    raise SettingError(
        f"lambda=null: {file} has no scale of method={config.method}. Choose one: python -m benchmark.choose_scales "
        f"methods=[{config.method}] scales_dir={config.scales_dir}, or give lambda."
    )


def scales_file(folder: str, task: "Task") -> Path:
    """The file of a task's chosen scales."""
    return Path(folder) / f"{task.name}.yaml"


def arm_folder(output_dir: str, recipe: str, arm: "PlacedArm") -> Path:
    """Where the scales of a recipe's policies are, on an arm as it stands."""
    return Path(output_dir) / recipe / arm_name(arm)


def read_methods(folder: Path, task: "Task", seeds: range) -> "pd.DataFrame":
    """These episodes in an arm's folder, whatever the method, of the task's present version; an empty table if none
    are."""
    import pandas as pd

    from benchmark.episodes.table import read_episodes

    tables = []
    others = sorted({each.name for each in folder.glob("*") if each.is_dir()} - {*METHODS})  # Classes in files.
    for method in (*METHODS, *others):
        table = read_episodes(folder / method)
        if len(table):
            present = table.episode_version == table.setting.map(task.episode_version)
            tables.append(table[present & table.episode_seed.isin(seeds)])
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
