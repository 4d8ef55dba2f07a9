"""Undisturbed demonstrations of the scripted oracle on the original's own xArm6, and the policies trained on them."""

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

from benchmark.studies.original_task.task import MakeOriginal, original_arm
from benchmark.training.recipes import CLEAN, MADE_BY
from benchmark.training.trainer import TrainConfig
from richmap.progress import progress_bar
from richmap.worker import worker_pool

SEEDS = (42, 43, 44)
STEPS = (8000, 8500, 9000)
"""Whose policies are kept: the last ones of a training, not chosen."""


def trainings(folder: Path, device: str, threads: int) -> list[TrainConfig]:
    """The recipe `clean` on these demonstrations, three seeds, three checkpoints each."""
    demonstrations = replace(CLEAN, output_dir=str(folder / "demonstrations"))
    return [
        TrainConfig(
            seed=seed, steps=STEPS[-1], keep=list(STEPS), device=device, threads=threads,
            policy=dict(MADE_BY["clean"].policy), demonstrations=demonstrations, output_dir=str(folder / "policies"),
        )
        for seed in SEEDS
    ]  # fmt: skip


def collect(assets: str, folder: Path, workers: int, episodes: int = CLEAN.count) -> Path:
    """The demonstrations of seeds 0 to 999, failed ones included, collected if they are not there; gives their folder.

    They are stored as `benchmark.collect` stores its own, so that training takes them.
    """
    from benchmark.training.demonstration_dataset import write_dataset
    from envs.block_push.task import BLOCK_PUSH

    root = folder / "demonstrations"
    if root.exists():
        return root
    partial = root.with_name(f".{root.name}.tmp")
    shutil.rmtree(partial, ignore_errors=True)
    config = replace(CLEAN, episodes=episodes)
    write_dataset(_played(assets, range(episodes), workers), partial, BLOCK_PUSH, episodes)
    about = {
        "recipe": config.recipe,
        "episode_version": BLOCK_PUSH.episode_version("embodied"),
        "simulation": "PyBullet, the original task",
    }
    (partial / "meta" / "collect.json").write_text(json.dumps(about, indent=2) + "\n")
    os.replace(partial, root)
    return root


def _played(assets: str, seeds: range, workers: int) -> Iterator:
    with progress_bar() as progress, worker_pool(workers) as pool:
        played = pool.map(_demonstrate, [assets] * len(seeds), seeds, chunksize=5)
        yield from list(progress.track(played, total=len(seeds), description="Demonstrations"))


def _demonstrate(assets: str, seed: int):
    from benchmark.training.demonstration import demonstrate

    return demonstrate(CLEAN.demonstrator, _source(assets), seed, "clean")


@cache
def _source(assets: str):
    return MakeOriginal(assets).with_plain_observation(original_arm("xarm6", 0.0))
