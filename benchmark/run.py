"""The main job: what does the xArm6's policy do on this arm, and does guidance help?

python -m benchmark.run robot=ur3 lambda=0.5
python -m benchmark.run robot=ur3 method=projection lambda=0.01
python -m benchmark.run -m experiment=transfer
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.checkpoint import GUIDED, Checkpoint
from benchmark.command import SettingError, run_command
from benchmark.config import EnergyConfig, MapConfig, RobotConfig, RunConfig
from benchmark.recipe import RECIPES, USUAL, policy_name
from policies.methods import METHODS

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.results import Condition
    from benchmark.rollout import Rollout
    from envs.arms import ArmSetting
    from richmap.energy import EnergyField

CHECKPOINTS = [
    Path(__file__).parents[1] / "results" / "checkpoints",
    *(Path("outputs") / "source_policies" / recipe for recipe in RECIPES),
    Path("outputs") / "checkpoints",
]
"""Where checkpoints are looked for: those that ship, and those that `benchmark.source_policies` and `benchmark.train`
make."""


def main(config: RunConfig) -> None:
    """Roll out at lambda and at 0 on the same episodes, store every episode, and print the comparison."""
    config = with_scale(config)
    checkpoint = chosen_checkpoint(config)
    from rich.console import Console

    from benchmark.experiment_log import log_curves, log_evaluation, log_field
    from benchmark.report import print_report

    console = Console()
    rollouts = [make_rollout(config, scale, checkpoint, console) for scale in sorted({0.0, config.guidance_scale})]
    tables = []
    for rollout in rollouts:
        log_field(config, rollout, config.output_dir)
        tables.append(run_and_store(rollout, config, console))
        log_evaluation(config, rollout, tables[-1], config.output_dir)
    log_curves(config.wandb, tables, config.output_dir)
    print_report(tables, Path(config.output_dir), console)


def with_scale(config: RunConfig) -> RunConfig:
    """The same settings with the scale that was chosen on validation episodes, if they leave it open.

    Raises:
        SettingError: If none was chosen.
    """
    if config.guidance_scale is not None:
        return config
    if config.method == "direct":
        return replace(config, guidance_scale=0.0)
    from benchmark.scales import chosen_scale

    return replace(config, guidance_scale=chosen_scale(config))


def chosen_checkpoint(config: RunConfig) -> Path:
    """Folder of the policy to roll out: the one named by its path, or else by its training seed.

    Raises:
        SettingError: If there is none, or it cannot be guided and should be.
    """
    if not config.policy:
        return checkpoint_folder(config.seed, config.checkpoint, config.recipe)
    checkpoint = Checkpoint.from_path(config.policy)
    if checkpoint.type != GUIDED and config.guidance_scale > 0:
        raise SettingError(
            f"lambda={config.guidance_scale:g} needs a policy of type {GUIDED}, whose sampling can be guided. "
            f"{config.policy} is of type {checkpoint.type}: use lambda=0."
        )
    return checkpoint.folder


def checkpoint_folder(seed: int, rank: int = 1, recipe: str = USUAL) -> Path:
    """Folder of the checkpoint of this rank with this training seed, of this recipe.

    Raises:
        SettingError: If there is none.
    """
    for root in CHECKPOINTS:
        folder = root / policy_name(recipe, seed, rank)
        if (folder / "model.safetensors").exists():
            return folder
    there = {folder.name for root in CHECKPOINTS for folder in policies_in(root, recipe)}
    raise SettingError(
        f"recipe={recipe} seed={seed} checkpoint={rank} is not there. Trained: {', '.join(sorted(there)) or 'none'}. "
        f"Train more: python -m benchmark.source_policies recipe={recipe} seeds=[{seed}]"
    )


def policies_in(folder: Path, recipe: str) -> list[Path]:
    """Folders of a recipe's policies in a folder."""
    return [file.parent for file in folder.glob(f"{policy_name(recipe, '*', '*')}/model.safetensors")]


def shipped(recipe: str = USUAL) -> set[str]:
    """Hashes of the weights of a recipe's policies that ship with the project."""
    return {Checkpoint(folder).weights_hash for folder in policies_in(CHECKPOINTS[0], recipe)}


def make_rollout(config: RunConfig, scale: float, checkpoint: Path, console: "Console") -> "Rollout":
    """What is rolled out at one lambda; builds the field if one is needed and not in the cache."""
    from benchmark.arm import chosen_arm
    from benchmark.rollout import Rollout

    arm, method = chosen_arm(config), config.method if scale > 0 else "direct"
    field, path = guidance_field(METHODS[method].field, arm, config, console)
    return Rollout(make_condition(config, arm, method, scale, checkpoint, field), checkpoint, path)


def make_condition(
    config: RunConfig,
    arm: "ArmSetting",
    method: str,
    scale: float,
    checkpoint: Path,
    field: "EnergyField | None",
    entry_hash: str = "",
) -> "Condition":
    """What a policy on an arm is run with, with the code and the device of this machine."""
    import math

    from benchmark.arithmetic import arithmetic
    from benchmark.arm import arm_columns
    from benchmark.results import Condition

    device = config.device
    if device != "cpu":
        import torch

        available = torch.cuda.is_available()
        if device == "cuda" and not available:
            raise SettingError(
                "device=cuda is not available: PyTorch finds no GPU here. Use device=cpu or device=auto."
            )
        device = "cuda" if available else "cpu"
    source = Checkpoint(checkpoint)
    code_version, commit = versions()
    sampler, steps = (config.sampler, config.sampling_steps) if source.type == GUIDED else source.sampler
    return Condition(
        **arm_columns(arm),
        method=method,
        guidance_scale=scale,
        sampler=sampler,
        sampling_steps=steps,
        training_seed=source.training_seed,
        checkpoint=source.name,
        checkpoint_hash=source.weights_hash,
        field_fingerprint=field.about["fingerprint"] if field else "",
        cell_size=field.grid.cell_size if field else math.nan,
        batch_shape=config.slots,
        device=device,
        code_version=code_version,
        commit=commit,
        entry_hash=entry_hash,
        arithmetic=arithmetic(),
    )


@cache
def versions() -> tuple[str, str]:
    """Version of the code that decides an episode, and commit of the tree, when this process first asked."""
    from benchmark.code_version import code_version, commit

    return code_version(), commit()


def guidance_field(
    kind: str | None, arm: "ArmSetting", config: RunConfig, console: "Console"
) -> tuple["EnergyField | None", Path | None]:
    """The field of a kind (`policies.methods.Method.field`) for this arm, and its file; None for None."""
    return _field(kind, arm, config.robot, config.map, config.energy, config.workers, console)


@cache
def _field(
    kind: str | None,
    arm: "ArmSetting",
    robot: RobotConfig,
    of_map: MapConfig,
    energy: EnergyConfig,
    workers: int,
    console: "Console",
) -> tuple["EnergyField | None", Path | None]:
    from benchmark.build_maps import energy_field
    from benchmark.feasibility_field import feasibility_field

    match kind:
        case "energy":
            return energy_field(robot.load(), arm.base, of_map, energy, workers, console)
        case "feasibility":
            return feasibility_field(arm, console)
    return None, None


def run_and_store(rollout: "Rollout", config: RunConfig, console: "Console") -> "pd.DataFrame":
    """Rows of all episodes of a rollout: the stored ones, and the rest run and stored batch by batch."""
    condition = rollout.condition
    name = f"{condition.robot}, {condition.method}, lambda {condition.guidance_scale:g}"
    (table,) = run_and_store_all([rollout], config, name, console)
    return table


def run_and_store_all(
    rollouts: "Sequence[Rollout]", config: RunConfig, name: str, console: "Console"
) -> "list[pd.DataFrame]":
    """The same for several rollouts, one after another under one progress bar of this name."""
    from benchmark.field_settings import note_settings
    from benchmark.missing_episodes import run_missing
    from benchmark.rollout import roll_out_all

    output_dir = Path(config.output_dir)
    note_settings(output_dir, rollouts, config)
    return run_missing(
        [rollout.condition for rollout in rollouts],
        range(config.seed_start, config.seed_start + config.episodes),
        lambda _: output_dir,
        lambda missing: roll_out_all(zip(rollouts, missing, strict=True), config.workers),
        name,
        console,
    )


if __name__ == "__main__":
    from hydra.core.plugins import Plugins

    plugins = Plugins.instance()  # It looks through the folders on the path, so not where this is run from elsewhere.
    from hydra_plugins.missing_jobs import MissingJobsSweeper

    plugins.register(MissingJobsSweeper)
    run_command(main, RunConfig, "run")
