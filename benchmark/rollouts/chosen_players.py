"""Who plays what settings of `benchmark.run` ask for: on one arm, or on each condition of a suite."""

from dataclasses import replace
from typing import TYPE_CHECKING

from benchmark.artifacts.known_policies import chosen_checkpoint
from benchmark.episodes.arm import chosen_arms
from benchmark.rollouts.arm_oracle import ArmOracle
from benchmark.rollouts.make_rollout import Stage
from benchmark.settings.chosen_scales import chosen_scales, scales_file
from benchmark.settings.config import ORACLE_METHODS, RunConfig
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task
from policies.methods import METHODS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from rich.console import Console

    from benchmark.rollouts.players import Player
    from benchmark.rollouts.rollout import Rollout
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task


def chosen_checkpoints(config: RunConfig) -> "list[Path]":
    """The policy of each training seed of a suite's, or the one policy; none for a scripted oracle.

    Raises:
        SettingError: If one is not there.
    """
    if config.method in ORACLE_METHODS.values():
        return []
    seeds = config.seeds if config.conditions else [config.seed]
    return [chosen_checkpoint(replace(config, seed=seed)) for seed in seeds]


def chosen_players(config: RunConfig, console: "Console") -> "Sequence[Player]":
    """Direct transfer, and then guidance at its scale, unless that is 0, on each arm of a run of one task with each
    policy; or a scripted oracle on each arm.

    Raises:
        SettingError: If a policy is not there or cannot be guided, no scale was chosen, or an arm cannot hold its tool
            over the task's start.
    """
    task, checkpoints = chosen_task(config.task), chosen_checkpoints(config)
    if config.guidance_scale is None and config.method in METHODS:
        chosen_scale(config, task)  # Whether there is one is known before postures are sought and maps are built.
    arms = chosen_arms(config, task)
    if config.method in ORACLE_METHODS.values():
        return [oracle_of(config.method, task, arm) for arm in arms]
    return rollouts_of([Stage(config, task, arm, checkpoint, console) for arm in arms for checkpoint in checkpoints])


def oracle_of(method: str, task: "Task", arm: "PlacedArm") -> ArmOracle:
    """The scripted oracle that a method names, on an arm."""
    (oracle,) = [oracle for oracle, name in ORACLE_METHODS.items() if name == method]
    return ArmOracle(task, arm, oracle)


def rollouts_of(stages: "Sequence[Stage]") -> "list[Rollout]":
    """Direct transfer on each of these stages of one method, and then guidance at its scale, unless that is 0."""
    scale = stages[0].config.guidance_scale
    if scale is None:
        scale = _usual_scale(stages[0])
    return [stage.rollout(each) for each in sorted({0.0, scale}) for stage in stages]


def _usual_scale(stage: Stage) -> float:
    if stage.entry is None:
        return chosen_scale(stage.config, stage.task)
    if stage.entry.default_scale is None:
        raise SettingError(f"lambda=null: {stage.config.method} names no default_scale. Give it one, or give lambda.")
    return stage.entry.default_scale


def chosen_scale(config: RunConfig, task: "Task") -> float:
    """The one scale of a method of ours that was chosen for its task, in `config.scales_dir`.

    Raises:
        SettingError: If none was.
    """
    if (chosen := chosen_scales(config.scales_dir, task.name).get(config.method)) is not None:
        return float(chosen["scale"])
    file = scales_file(config.scales_dir, task.name)
    raise SettingError(
        f"lambda=null: {file} has no scale of method={config.method}. Choose one: python -m benchmark.choose_scales "
        f"methods=[{config.method}] scales_dir={config.scales_dir}, or give lambda."
    )
