"""Trainer."""

import os
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.artifacts.alone import alone
from benchmark.settings.config import WandbConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import SOURCE_IN_WORDS
from benchmark.settings.setting import SettingError, check_counts, check_setting
from benchmark.settings.task import chosen_task
from benchmark.training.collection import collect, digest
from benchmark.training.demonstration_recipe import CollectConfig
from benchmark.training.recipes import POLICIES

if TYPE_CHECKING:
    from accelerate import Accelerator
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.utils.logging_utils import MetricsTracker

    from benchmark.training.demonstration_tensors import DemonstrationTensors
    from policies.configuration_guided_push import GuidedPushConfig


LOG_EVERY = 50
"""Steps over which loss, learning rate and gradient norm are averaged for the curve and W&B."""


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
    keep: list[int] = field(default_factory=list)
    """Steps whose policies are kept, as in keep=[8000,9000], in folders seed<seed>-step<step>; none for the last alone,
    in a folder seed<seed>-1."""
    policy: dict[str, Any] = field(default_factory=dict)
    """Fields of `GuidedPushConfig` that differ from its defaults."""
    demonstrations: CollectConfig = field(default_factory=CollectConfig)
    """Data to learn from, collected first if they are not there."""
    output_dir: str = "outputs/checkpoints"
    """Folder of the checkpoints' folders."""
    wandb: WandbConfig = field(default_factory=WandbConfig)

    def __post_init__(self) -> None:
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_folder(self.output_dir)
        choices = {"precision": ("bfloat16", "float32"), "device": ("cpu", "cuda")}
        for name, allowed in choices.items():
            check_setting(getattr(self, name) in allowed, name, getattr(self, name), ", ".join(allowed))
        check_counts(self, "steps", "batch_size", "threads", "save_every")
        kept = all(1 <= step <= self.steps for step in self.keep)
        check_setting(kept, "keep", self.keep, f"steps from 1 to {self.steps}")

    @property
    def checkpoints(self) -> dict[int, Path]:
        """Folders of the finished policies, by step."""
        folder = Path(self.output_dir)
        kept = {step: folder / f"seed{self.seed}-step{step}" for step in sorted(self.keep)}
        return kept or {self.steps: folder / f"seed{self.seed}-1"}

    @property
    def states(self) -> Path:
        """Folder of the states of an unfinished run; runs with other settings never share one."""
        indifferent = {"save_every": None, "keep": None, "wandb": None}
        recipe = {**asdict(self), "demonstrations": self.demonstrations.recipe, **indifferent}
        return Path(self.output_dir) / f".seed{self.seed}-{digest(recipe)}"


def check_free(config: TrainConfig) -> None:
    """Raise `SettingError` if a checkpoint is there already, unless a training of it goes on."""
    for path in [] if config.states.exists() else config.checkpoints.values():
        if path.exists():
            raise SettingError(f"{path} exists. Delete it or choose another output_dir.")


def train(config: TrainConfig, report: Callable[[int, float], None] = lambda step, loss: None) -> list[Path]:
    """Trains a policy, demonstrations included, and gives the folders of its checkpoints, the last one last.

    A run that was killed goes on from the last state it had stored, exactly as if nothing had happened.

    Args:
        config: How.
        report: Called after each step with the number of steps done and the mean loss of late.

    Raises:
        SettingError: If a checkpoint is there already, or another process trains it just now.
    """
    paths = list(config.checkpoints.values())
    with alone(paths[-1]):
        check_free(config)
        _train(config, collect(config.demonstrations), report)
    return paths


def _train(config: TrainConfig, root: Path, report: Callable[[int, float], None]) -> None:
    os.environ.setdefault("HF_HUB_OFFLINE", "1")  # Nothing here needs the hub.
    import torch

    from benchmark.training.demonstration_tensors import load_demonstrations

    torch.set_num_threads(config.threads)
    demonstrations = load_demonstrations(root)
    pipeline = _pipeline(config, root)
    _optimise(config, pipeline, demonstrations, report)
    shutil.rmtree(config.states)


def _pipeline(config: TrainConfig, root: Path) -> "TrainPipelineConfig":
    """The same run in LeRobot's terms; it is stored in the checkpoint."""
    from lerobot.configs.default import DatasetConfig
    from lerobot.configs.train import TrainPipelineConfig

    from policies.configuration_guided_push import GuidedPushConfig

    task = config.demonstrations.task
    given = {**POLICIES.get(task, {}), **config.policy}
    policy = GuidedPushConfig(device=config.device, space=chosen_task(task).space, **given)
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


def _optimise(
    config: TrainConfig,
    pipeline: "TrainPipelineConfig",
    demonstrations: "DemonstrationTensors",
    report: Callable[[int, float], None],
) -> None:
    """All steps, from the stored state if there is one; checkpoints appear as their steps are done."""
    import pandas as pd
    from lerobot.optim.factory import make_optimizer_and_scheduler
    from lerobot.policies import make_policy, make_pre_post_processors
    from lerobot.scripts.lerobot_train import update_policy
    from lerobot.utils.random_utils import set_seed

    from benchmark.artifacts.wandb_run import start_experiment
    from benchmark.training.training_state import CURVE, last_state, load_meters, load_state, save_state

    set_seed(config.seed)
    policy = make_policy(pipeline.policy, ds_meta=demonstrations.meta)
    processors = make_pre_post_processors(pipeline.policy, dataset_stats=demonstrations.meta.stats)
    optimizer, scheduler = make_optimizer_and_scheduler(pipeline, policy)
    state = last_state(config.states)
    first = load_state(state, policy, optimizer, scheduler) if state else 0
    curve = pd.read_csv(state / CURVE, float_precision="round_trip").to_dict("records") if state else []
    if state and first in config.checkpoints:  # Killed just before it was published, perhaps.
        _publish(state, first, config, pipeline, demonstrations)
    accelerator, tracker = _accelerator(config), _tracker(config, demonstrations)
    if state:
        load_meters(state, tracker)
    ready, ready_optimizer, ready_scheduler = accelerator.prepare(policy, optimizer, scheduler)
    clip = pipeline.optimizer.grad_clip_norm
    with start_experiment(config.wandb, f"seed{config.seed}", config.output_dir, "train", asdict(config)) as run:
        for step in range(first + 1, config.steps + 1):
            batch = processors[0](demonstrations.batch(config.seed, step - 1, config.batch_size, pipeline.policy))
            update_policy(tracker, ready, batch, ready_optimizer, clip, accelerator, ready_scheduler)
            report(step, tracker.loss.avg)
            if step % LOG_EVERY == 0:
                values = {name: tracker.metrics[name].avg for name in ("loss", "lr", "grad_norm")}
                curve.append({"step": step, **values})
                run.log({f"train/{name}": value for name, value in values.items()}, step=step)
                tracker.reset_averages()
            if step % config.save_every == 0 or step in {*config.checkpoints, config.steps}:
                losses = pd.DataFrame(curve, columns=["step", "loss", "lr", "grad_norm"])
                state = save_state(
                    config.states, step, pipeline, policy, optimizer, scheduler, processors, losses, tracker
                )
                if step in config.checkpoints:
                    _publish(state, step, config, pipeline, demonstrations)


def _accelerator(config: TrainConfig) -> "Accelerator":
    from accelerate import Accelerator

    precision = {"bfloat16": "bf16", "float32": "no"}[config.precision]
    return Accelerator(step_scheduler_with_optimizer=False, mixed_precision=precision, cpu=config.device == "cpu")


def _tracker(config: TrainConfig, demonstrations: "DemonstrationTensors") -> "MetricsTracker":
    from lerobot.utils.logging_utils import AverageMeter, MetricsTracker

    meters = {name: AverageMeter(name) for name in ("loss", "grad_norm", "lr", "update_s", "gpu_mem_gb")}
    return MetricsTracker(config.batch_size, demonstrations.n_frames, demonstrations.n_episodes, meters)


def _publish(
    state: Path, step: int, config: TrainConfig, pipeline: "TrainPipelineConfig", demonstrations: "DemonstrationTensors"
) -> None:
    """Puts the policy of a state where checkpoints belong, with its card, in one atomic move; once."""
    checkpoint = config.checkpoints[step]
    if checkpoint.exists():
        return
    from benchmark.artifacts.commit import commit
    from benchmark.training.model_card import write_model_card
    from benchmark.training.training_state import CURVE

    partial = checkpoint.with_name(f".{checkpoint.name}.tmp")
    shutil.rmtree(partial, ignore_errors=True)
    shutil.copytree(state / "pretrained_model", partial)
    shutil.copy(state / CURVE, partial)
    policy = pipeline.policy
    facts = {
        "robot": SOURCE_IN_WORDS,
        "dataset": demonstrations.meta.repo_id,
        "episodes": demonstrations.n_episodes,
        "frames": demonstrations.n_frames,
        "kinds": ", ".join(f"{count} {kind}" for kind, count in demonstrations.kinds.items()),
        "step": step,
        "augmentation": _augmentation(policy),
        "task": chosen_task(config.demonstrations.task).description,
        "units": ", ".join(
            f"{size:g} {unit}" for size, unit in zip(policy.action_units, policy.space.action.units, strict=True)
        ),
        "environment": config.demonstrations.demonstrator.environment,
        "sampler": policy.noise_scheduler_type,
        "sampling_steps": policy.num_inference_steps,
        "training_levels": policy.num_train_timesteps,
        "prediction": policy.prediction_type,
        "commit": commit(),
    }
    values = {key: value for key, value in asdict(config).items() if key != "wandb"}
    write_model_card(partial, checkpoint.name, {**facts, **values}, values)
    os.replace(partial, checkpoint)


def _augmentation(policy: "GuidedPushConfig") -> str:
    kinds = {
        "the task's exact permutations of things that are alike": policy.permute,
        f"the effector displaced by {1000 * policy.displacement:g} mm per axis": policy.displacement > 0,
    }
    return ", ".join(kind for kind, used in kinds.items() if used) or "none"
