"""What is rolled out, from the settings of `benchmark.run`: the condition with the policy, the arm and the field."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.artifacts.checkpoint import GUIDED, Checkpoint
from benchmark.artifacts.fields import guidance_field
from benchmark.episodes.arm import chosen_arm
from benchmark.settings.command import SettingError
from benchmark.settings.config import RunConfig
from benchmark.settings.task import chosen_task
from policies.methods import METHODS

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.episodes.episode import Condition
    from benchmark.rollouts.rollout import Rollout
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task
    from richmap.similarity.load_field import StoredField


@dataclass(frozen=True)
class Stage:
    """What settings name, each looked up once: the task, the arm, the policy, and the field of the method."""

    config: RunConfig
    task: "Task"
    arm: "PlacedArm"
    checkpoint: Path
    console: "Console"

    @cached_property
    def field(self) -> "tuple[StoredField | None, Path | None]":
        """What the method looks at, and its file; built if it is not in the cache."""
        c = self.config
        return guidance_field(METHODS[c.method].field, self.arm, c.map, c.energy, c.workers, self.console)

    def rollout(self, scale: float) -> "Rollout":
        """What is rolled out there at a scale; direct transfer at 0."""
        from benchmark.rollouts.rollout import Rollout

        method, (field, file) = (self.config.method, self.field) if scale else ("direct", (None, None))
        condition = make_condition(self.config, self.arm, method, scale, self.checkpoint, field)
        return Rollout(self.task, self.arm, condition, self.checkpoint, file, kind=METHODS[method].field)


def set_stage(config: RunConfig, checkpoint: Path, console: "Console") -> Stage:
    """The stage of a run's settings."""
    task = chosen_task(config.task)
    return Stage(config, task, chosen_arm(config, task), checkpoint, console)


def make_rollout(config: RunConfig, scale: float, checkpoint: Path, console: "Console") -> "Rollout":
    """What is rolled out at one lambda; builds the field if one is needed and not in the cache."""
    return set_stage(config, checkpoint, console).rollout(scale)


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
        batch_size=config.batch_size,
        device=device,
        commit=commit(),
        episode_version=task.episode_version(arm.setting),
        entry_hash=entry_hash,
    )
