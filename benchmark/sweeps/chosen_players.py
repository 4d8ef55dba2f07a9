"""Who plays what settings of `benchmark.run` ask for: on one arm, or on each condition of a suite."""

from dataclasses import replace
from typing import TYPE_CHECKING

from benchmark.settings.config import ORACLE_METHODS, RunConfig
from benchmark.settings.suite import suite_runs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from benchmark.rollouts.arm_oracle import ArmOracle
    from benchmark.rollouts.players import Player
    from benchmark.rollouts.rollout import Rollout


def chosen_players(config: RunConfig, console: "Console") -> "Sequence[Player]":
    """Direct transfer, and then guidance at its scale, unless that is 0, with the policy of each training seed on each
    condition of a suite, or with one policy on one arm; or a scripted oracle.

    Raises:
        SettingError: If no scale was chosen, an arm cannot stand so, or a policy is not there or cannot be guided.
    """
    runs = [*suite_runs(config).values()] or [config]
    if config.method in ORACLE_METHODS.values():
        return [oracle_of(run) for run in runs]
    runs = [replace(run, seed=seed) for run in runs for seed in config.seeds] if config.conditions else runs
    rollouts = [rollout for run in runs for rollout in rollouts_of(run, console)]
    return sorted(rollouts, key=lambda rollout: rollout.condition.guidance_scale)


def oracle_of(config: RunConfig) -> "ArmOracle":
    """The scripted oracle that the method names, on the arm."""
    from benchmark.episodes.arm import chosen_arm
    from benchmark.rollouts.arm_oracle import ArmOracle
    from benchmark.settings.task import chosen_task

    task = chosen_task(config.task)
    (oracle,) = [oracle for oracle, method in ORACLE_METHODS.items() if method == config.method]
    return ArmOracle(task, chosen_arm(config, task), oracle)


def rollouts_of(config: RunConfig, console: "Console") -> "list[Rollout]":
    """Direct transfer, and guidance at its scale unless that is 0, with one policy on one arm."""
    from benchmark.artifacts.known_policies import chosen_checkpoint
    from benchmark.rollouts.make_rollout import set_stage
    from benchmark.sweeps.chosen_scale import chosen_scale

    stage = set_stage(config, chosen_checkpoint(config), console)
    scale = chosen_scale(stage) if config.guidance_scale is None else config.guidance_scale
    return [stage.rollout(each) for each in sorted({0.0, scale})]
