"""What a policy on an arm is run with."""

from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.artifacts.checkpoint import GUIDED, Checkpoint
from benchmark.settings.config import RunConfig
from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    from benchmark.episodes.episode import Condition
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task
    from richmap.similarity.load_field import StoredField


def make_condition(
    config: RunConfig,
    task: "Task",
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
    source = Checkpoint(checkpoint)
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
        cell_size=field.grid.cell_size if field and field.grid else math.nan,
        batch_size=config.batch_size,
        device=device,
        commit=commit(),
        episode_version=task.episode_version(arm.setting),
        entry_hash=entry_hash,
    )
