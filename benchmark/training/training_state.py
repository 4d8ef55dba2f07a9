"""A training run's states on disk: LeRobot's checkpoint, and the weights that are being trained."""

import json
import os
import shutil
from pathlib import Path

import pandas as pd
from lerobot.common.train_utils import load_training_state, save_checkpoint
from lerobot.configs.train import TrainPipelineConfig
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.logging_utils import MetricsTracker
from safetensors.torch import load_file, save_file
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from policies.modeling_guided_push import GuidedPushPolicy
from policies.weight_average import WeightAverage
from richmap.outputs import writing

RAW_WEIGHTS = Path("training_state") / "raw_weights.safetensors"
"""LeRobot's checkpoint holds the averaged weights, which are the policy; training goes on from these."""
CURVE = "training_curve.csv"
"""Loss, learning rate and gradient norm so far."""
METERS = Path("training_state") / "meters.json"
"""Sums of what is averaged for the curve's next line."""


def save_state(
    folder: Path,
    step: int,
    pipeline: TrainPipelineConfig,
    policy: GuidedPushPolicy,
    optimizer: Optimizer,
    scheduler: LRScheduler,
    processors: tuple[PolicyProcessorPipeline, PolicyProcessorPipeline],
    curve: pd.DataFrame,
    tracker: MetricsTracker,
) -> Path:
    """Stores the state after this many steps in one atomic move, then removes the one before."""
    partial, complete = folder / "partial", folder / f"{step:06d}"
    shutil.rmtree(partial, ignore_errors=True)
    with writing(complete):
        batch_size = pipeline.batch_size
        save_checkpoint(partial, step, pipeline, policy, optimizer, scheduler, *processors, batch_size=batch_size)
        save_file(policy.state_dict(), partial / RAW_WEIGHTS)
        curve.to_csv(partial / CURVE, index=False)
        (partial / METERS).write_text(json.dumps({name: vars(meter) for name, meter in tracker.metrics.items()}))
    before = last_state(folder)
    os.replace(partial, complete)
    if before:
        shutil.rmtree(before)
    return complete


def last_state(folder: Path) -> Path | None:
    """Folder of the latest complete state."""
    return max(folder.glob("[0-9]*"), default=None)


def load_state(state: Path, policy: GuidedPushPolicy, optimizer: Optimizer, scheduler: LRScheduler) -> int:
    """Takes up weights, their average, optimiser, scheduler and random state; gives the steps done."""
    policy.load_state_dict(load_file(state / RAW_WEIGHTS))
    step, _, _ = load_training_state(state, optimizer, scheduler)
    policy.average = WeightAverage(policy, policy.config.average_decay, n_updates=step)
    averaged = load_file(state / "pretrained_model" / "model.safetensors", device=str(policy.config.device))
    policy.average.weights = {name: averaged[name] for name in policy.average.weights}
    return step


def load_meters(state: Path, tracker: MetricsTracker) -> None:
    """Takes up what was averaged since the curve's last line; states of before 26 November 2026 do not hold it."""
    if not (state / METERS).exists():
        return
    for name, values in json.loads((state / METERS).read_text()).items():
        vars(tracker.metrics[name]).update(values)
