"""Training of one source policy with LeRobot's own pieces, on demonstrations that are held in memory.

    python -m benchmark.train

LeRobot's data loader takes milliseconds per sample, more than the network; everything else is LeRobot's: the
policy and its presets, the update, the checkpoint. `lerobot-train` does the same, sample by sample.
"""

import os
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.collect import CollectConfig, collect, digest
from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import check_folder

if TYPE_CHECKING:
    from accelerate import Accelerator
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.utils.logging_utils import MetricsTracker

    from benchmark.demonstration_tensors import DemonstrationTensors


@dataclass
class TrainConfig:
    """How one source policy is trained."""

    seed: int = 42
    """Training seed: initial weights, order of the data, noise."""
    steps: int = 9000
    """Optimiser steps."""
    batch_size: int = 256
    """Observations per step; each meets `GuidedPushConfig.noise_draws` noise levels."""
    precision: str = "bfloat16"
    """Arithmetic of the matrix products: bfloat16 or float32."""
    device: str = "cpu"
    """cpu or cuda."""
    threads: int = 1
    """CPU threads of the arithmetic; the result depends on it in the last digits."""
    save_every: int = 1000
    """Steps between two states that a killed run can go on from; about half a minute."""
    policy: dict[str, Any] = field(default_factory=dict)
    """Fields of `GuidedPushConfig` that differ from its defaults."""
    demonstrations: CollectConfig = field(default_factory=CollectConfig)
    """Data to learn from, collected first if they are not there."""
    output_dir: str = "outputs/checkpoints"
    """Folder in which the checkpoint gets a folder named after the seed."""

    def __post_init__(self) -> None:
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_folder(self.output_dir)
        choices = {"precision": ("bfloat16", "float32"), "device": ("cpu", "cuda")}
        for name, allowed in choices.items():
            check_setting(getattr(self, name) in allowed, name, getattr(self, name), ", ".join(allowed))
        for name in ("steps", "batch_size", "threads", "save_every"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")

    @property
    def checkpoint(self) -> Path:
        """Folder of the finished policy."""
        return Path(self.output_dir) / f"seed{self.seed}-1"

    @property
    def states(self) -> Path:
        """Folder of the states of an unfinished run; runs with other settings never share one."""
        recipe = {**asdict(self), "demonstrations": self.demonstrations.recipe, "save_every": None}
        return self.checkpoint.with_name(f".{self.checkpoint.name}-{digest(recipe)}")


def train(config: TrainConfig) -> Path:
    """Trains a policy, demonstrations included, and gives the checkpoint's folder.

    A run that was killed goes on from the last state it had stored, exactly as if nothing had happened.

    Raises:
        SettingError: The checkpoint is there already.
    """
    if config.checkpoint.exists():
        raise SettingError(f"{config.checkpoint} exists. Delete it or choose another output_dir.")
    root = collect(config.demonstrations)
    os.environ.setdefault("HF_HUB_OFFLINE", "1")  # Nothing here needs the hub.
    import torch

    from benchmark.demonstration_tensors import load_demonstrations

    torch.set_num_threads(config.threads)
    demonstrations = load_demonstrations(root)
    pipeline = _pipeline(config, root)
    state = _optimise(config, pipeline, demonstrations)
    _publish(state, config, pipeline, demonstrations)
    shutil.rmtree(config.states)
    return config.checkpoint


def _pipeline(config: TrainConfig, root: Path) -> "TrainPipelineConfig":
    """The same run in LeRobot's terms; it is stored in the checkpoint."""
    from lerobot.configs.default import DatasetConfig
    from lerobot.configs.train import TrainPipelineConfig

    from policies.configuration_guided_push import GuidedPushConfig

    policy = GuidedPushConfig(device=config.device, **config.policy)
    return TrainPipelineConfig(
        DatasetConfig(f"local/{root.name}", root=str(root), video_backend="pyav"),
        policy=policy,
        output_dir=config.states,
        seed=config.seed,
        batch_size=config.batch_size,
        steps=config.steps,
        save_freq=config.save_every,
        env_eval_freq=0,
        optimizer=policy.get_optimizer_preset(),
        scheduler=policy.get_scheduler_preset(),
    )


def _optimise(config: TrainConfig, pipeline: "TrainPipelineConfig", demonstrations: "DemonstrationTensors") -> Path:
    """All steps, from the stored state if there is one; gives the folder of the last state."""
    from lerobot.optim.factory import make_optimizer_and_scheduler
    from lerobot.policies import make_policy, make_pre_post_processors
    from lerobot.scripts.lerobot_train import update_policy
    from lerobot.utils.random_utils import set_seed

    from benchmark.progress import progress_bar
    from benchmark.training_state import last_state, load_state, save_state

    set_seed(config.seed)
    policy = make_policy(pipeline.policy, ds_meta=demonstrations.meta)
    processors = make_pre_post_processors(pipeline.policy, dataset_stats=demonstrations.meta.stats)
    optimizer, scheduler = make_optimizer_and_scheduler(pipeline, policy)
    state = last_state(config.states)
    first = load_state(state, policy, optimizer, scheduler) if state else 0
    accelerator, tracker = _accelerator(config), _tracker(config, demonstrations)
    ready, ready_optimizer, ready_scheduler = accelerator.prepare(policy, optimizer, scheduler)
    with progress_bar() as progress:
        task = progress.add_task("Training", total=config.steps, completed=first)
        for step in range(first, config.steps):
            batch = processors[0](demonstrations.batch(config.seed, step, config.batch_size, pipeline.policy))
            clip = pipeline.optimizer.grad_clip_norm
            update_policy(tracker, ready, batch, ready_optimizer, clip, accelerator, ready_scheduler)
            progress.update(task, advance=1, description=f"Training, loss {tracker.loss.avg:.4f}")
            if (step + 1) % config.save_every == 0 or step + 1 == config.steps:
                state = save_state(config.states, step + 1, pipeline, policy, optimizer, scheduler, processors)
                tracker.reset_averages()
    return state


def _accelerator(config: TrainConfig) -> "Accelerator":
    from accelerate import Accelerator

    precision = {"bfloat16": "bf16", "float32": "no"}[config.precision]
    return Accelerator(step_scheduler_with_optimizer=False, mixed_precision=precision, cpu=config.device == "cpu")


def _tracker(config: TrainConfig, demonstrations: "DemonstrationTensors") -> "MetricsTracker":
    from lerobot.utils.logging_utils import AverageMeter, MetricsTracker

    meters = {name: AverageMeter(name) for name in ("loss", "grad_norm", "lr", "update_s", "gpu_mem_gb")}
    return MetricsTracker(config.batch_size, demonstrations.n_frames, demonstrations.n_episodes, meters)


def _publish(
    state: Path, config: TrainConfig, pipeline: "TrainPipelineConfig", demonstrations: "DemonstrationTensors"
) -> None:
    """Puts the policy of a state where checkpoints belong, with its card, in one atomic move."""
    from benchmark.model_card import write_model_card
    from benchmark.rollout import code_version, commit

    partial = config.checkpoint.with_name(f".{config.checkpoint.name}.tmp")
    shutil.rmtree(partial, ignore_errors=True)
    shutil.copytree(state / "pretrained_model", partial)
    policy = pipeline.policy
    facts = {
        "robot": demonstrations.meta.robot_type,
        "episodes": demonstrations.n_episodes,
        "frames": demonstrations.n_frames,
        "kinds": ", ".join(f"{count} {kind}" for kind, count in demonstrations.kinds.items()),
        "action_unit": policy.action_unit,
        "sampler": policy.noise_scheduler_type,
        "sampling_steps": policy.num_inference_steps,
        "training_levels": policy.num_train_timesteps,
        "prediction": policy.prediction_type,
        "code": code_version(),
        "commit": commit(),
    }
    values = asdict(config)
    write_model_card(partial, config.checkpoint.name, {**facts, **values}, values)
    os.replace(partial, config.checkpoint)


def main(config: TrainConfig) -> None:
    """Train, and say where the checkpoint is."""
    print(f"Checkpoint: {train(config)}")


if __name__ == "__main__":
    run_command(main, TrainConfig, "train")
