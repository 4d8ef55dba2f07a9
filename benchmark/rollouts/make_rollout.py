"""What is rolled out, from the settings of `benchmark.run`: the condition with the policy, the arm and the field."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.artifacts.checkpoint import GUIDED, Checkpoint
from benchmark.settings.command import SettingError
from benchmark.settings.config import EnergyConfig, MapConfig, RunConfig
from benchmark.settings.task import chosen_task
from policies.methods import METHODS

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.episodes.episode import Condition
    from benchmark.rollouts.rollout import Rollout
    from envs.arm.placed_arm import PlacedArm
    from richmap.similarity.load_field import StoredField


def make_rollout(config: RunConfig, scale: float, checkpoint: Path, console: "Console") -> "Rollout":
    """What is rolled out at one lambda; builds the field if one is needed and not in the cache."""
    from benchmark.episodes.arm import chosen_arm
    from benchmark.rollouts.rollout import Rollout

    arm, method = chosen_arm(config), config.method if scale > 0 else "direct"
    field, path = guidance_field(METHODS[method].field, arm, config, console)
    condition = make_condition(config, arm, method, scale, checkpoint, field)
    return Rollout(chosen_task(config.task), arm, condition, checkpoint, path)


def make_condition(
    config: RunConfig,
    arm: "PlacedArm",
    method: str,
    scale: float,
    checkpoint: Path,
    field: "StoredField | None",
    entry_hash: str = "",
) -> "Condition":
    """What a policy on an arm is run with, with the device of this machine."""
    import math

    from benchmark.artifacts.commit import commit
    from benchmark.episodes.arm import arm_columns
    from benchmark.episodes.episode import Condition

    device = config.device
    if device != "cpu":
        import torch

        available = torch.cuda.is_available()
        if device == "cuda" and not available:
            raise SettingError(
                "device=cuda is not available: PyTorch finds no GPU here. Use device=cpu or device=auto."
            )
        device = "cuda" if available else "cpu"
    source, task = Checkpoint(checkpoint), chosen_task(config.task)
    sampler, steps = (config.sampler, config.sampling_steps) if source.type == GUIDED else source.sampler
    return Condition(
        task=task.name,
        **arm_columns(arm),
        method=method,
        guidance_scale=scale,
        sampler=sampler,
        sampling_steps=steps,
        training_seed=source.training_seed,
        checkpoint=source.name,
        checkpoint_hash=source.policy_hash,
        field_fingerprint=field.about["fingerprint"] if field else "",
        cell_size=field.grid.cell_size if field else math.nan,
        batch_size=config.slots,
        device=device,
        commit=commit(),
        episode_version=task.episode_version(arm.setting),
        entry_hash=entry_hash,
    )


def guidance_field(
    kind: str | None, arm: "PlacedArm", config: RunConfig, console: "Console"
) -> tuple["StoredField | None", Path | None]:
    """The field of a kind (`policies.methods.Method.field`) for this arm, and its file; None for None."""
    return _field(kind, arm, config.map, config.energy, config.workers, console)


@cache
def _field(
    kind: str | None,
    arm: "PlacedArm",
    of_map: MapConfig,
    energy: EnergyConfig,
    workers: int,
    console: "Console",
) -> tuple["StoredField | None", Path | None]:
    from benchmark.artifacts.distance_field import distance_field
    from benchmark.artifacts.maps import energy_field

    match kind:
        case "energy":
            return energy_field(arm.description.turned(arm.yaw), arm.base, of_map, energy, workers, console)
        case "feasibility":
            return distance_field(arm, console)
    return None, None
