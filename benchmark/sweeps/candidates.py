"""Candidates for source policies: trained, validated, ranked, and the best of them published."""

import os
import shutil
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.artifacts.known_policies import of_task
from benchmark.settings.config import RunConfig, WandbConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.recipe import USUAL, check_recipe, policy_name
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.scenes import check_scenes
from benchmark.settings.setting import SettingError, check_choice, check_counts, check_setting
from benchmark.settings.task import chosen_task
from benchmark.training.demonstration_recipe import CollectConfig
from benchmark.training.recipes import MADE_BY
from benchmark.training.trainer import TrainConfig

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from envs.task import Task


@dataclass
class SourcePoliciesConfig:
    """Trains policies from several seeds and keeps the best checkpoints of each, by their validation episodes."""

    task: str = "block_push"
    """What they learn to do (see benchmark.run)."""
    recipe: str = USUAL
    """What they learn from and see: robust (episodes with noise and bursts, scenes all over the table) or clean
    (undisturbed episodes of block_push alone)."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds, whole numbers >= 0."""
    steps: int = 9000
    """Optimiser steps of a training."""
    candidates: list[int] = field(default_factory=lambda: [7500, 8000, 8500, 9000])
    """Steps whose policies are candidates."""
    best: int = 3
    """Candidates of each seed that are published, as seed<seed>-1 and so on; those of a recipe other than robust with
    its name before that, as clean-seed42-1."""
    episodes: int = 100
    """Validation episodes of each candidate on the xArm6; a whole number >= 1."""
    seed_start: int = 50_000
    """Seed of the first validation episode."""
    device: str = "cpu"
    """Where policies are trained and run: cpu or cuda."""
    policy: dict[str, Any] = field(default_factory=dict)
    """Fields of `GuidedPushConfig` that differ from the recipe's."""
    output_dir: str = "outputs/source_policies"
    """Folder that gets a folder named after the recipe, and in it one named after a task other than block_push."""
    workers: int = 2
    """Processes that simulate, train or roll out; results do not depend on it. A whole number >= 1."""
    wandb: WandbConfig = field(default_factory=WandbConfig)

    def __post_init__(self) -> None:
        check_recipe(self.recipe)
        made = self.recipe == USUAL or MADE_BY[self.recipe].demonstrations.task == self.task
        check_setting(made, "recipe", self.recipe, f"{USUAL}, the one for task={self.task}")
        check_setting(bool(self.seeds) and min(self.seeds) >= 0, "seeds", self.seeds, "whole numbers >= 0")
        within = bool(self.candidates) and 1 <= min(self.candidates) <= max(self.candidates) <= self.steps
        check_setting(within, "candidates", self.candidates, f"steps from 1 to {self.steps}")
        number = len(set(self.candidates))
        check_setting(1 <= self.best <= number, "best", self.best, f"a whole number from 1 to {number}")
        check_counts(self, "episodes", "workers")
        check_scenes(self.seed_start, self.episodes)
        check_choice("device", self.device, ("cpu", "cuda"))
        check_folder(self.output_dir)
        check_folder(self.demonstrations.folder)

    @property
    def demonstrations(self) -> CollectConfig:
        """What they learn from."""
        made = MADE_BY[self.recipe]
        return replace(made.demonstrations, task=self.task, output_dir=made.folder)

    @property
    def folder(self) -> Path:
        """Where checkpoints, the table and the validation episodes go."""
        return of_task(Path(self.output_dir) / self.recipe, self.task)


def trainings(config: SourcePoliciesConfig) -> list[TrainConfig]:
    """One training for each seed, which leaves all candidates."""
    return [
        TrainConfig(
            seed=seed,
            steps=config.steps,
            device=config.device,
            keep=config.candidates,
            policy={**MADE_BY[config.recipe].policy, **config.policy},
            demonstrations=config.demonstrations,
            output_dir=str(config.folder / "candidates"),
            wandb=config.wandb,
        )
        for seed in config.seeds
    ]


def validate(config: SourcePoliciesConfig, console: "Console") -> "pd.DataFrame":
    """Scores of every candidate on the validation episodes: one row each, with its seed, step, folder and hash."""
    import pandas as pd

    from benchmark.rollouts.make_rollout import make_rollout
    from benchmark.rollouts.missing_episodes import play_and_store

    run = RunConfig(
        robot=RobotConfig("xarm6"),
        task=config.task,
        episodes=config.episodes,
        seed_start=config.seed_start,
        device=config.device,
        workers=config.workers,
        output_dir=str(config.folder),
    )
    candidates = [
        {"seed": training.seed, "step": step, "path": path}
        for training in trainings(config)
        for step, path in training.checkpoints.items()
    ]
    rollouts = [make_rollout(run, 0.0, Path(str(candidate["path"])), console) for candidate in candidates]
    tables = play_and_store(rollouts, run, console, f"{len(rollouts)} candidates")
    task = chosen_task(config.task)
    names = sorted({*task.score_names, task.success})
    return pd.DataFrame(
        [
            {**candidate, "hash": rollout.condition.checkpoint_hash, "n": len(table), "length": table.length.mean()}
            | {name: table[name].astype(float).mean() for name in names}
            for candidate, rollout, table in zip(candidates, rollouts, tables, strict=True)
        ]
    )


def ranking(candidates: "pd.DataFrame", task: "Task", best: int, recipe: str = USUAL) -> "pd.DataFrame":
    """Each seed's candidates by the task's `headline`, then shortness; the best get their name in the column
    `checkpoint`."""
    table = candidates.sort_values(
        ["seed", *task.headline, "length", "step"],
        ascending=[True, *[False] * len(task.headline), True, False],
        ignore_index=True,
    )
    rank = table.groupby("seed").cumcount() + 1
    named = [policy_name(recipe, *of_row) if of_row[1] <= best else "" for of_row in zip(table.seed, rank, strict=True)]
    return table.assign(checkpoint=named)


def publish(table: "pd.DataFrame", config: SourcePoliciesConfig) -> None:
    """Copies the best candidates to their names, each in one atomic move.

    Raises:
        SettingError: One of the names holds another policy.
    """
    for row in table[table.checkpoint != ""].itertuples():
        path = config.folder / row.checkpoint
        if path.exists():
            if (path / "model.safetensors").read_bytes() != (row.path / "model.safetensors").read_bytes():
                raise SettingError(f"{path} holds another policy. Delete it or choose another output_dir.")
            continue
        partial = path.with_name(f".{path.name}.tmp")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(row.path, partial)
        card = (partial / "README.md").read_text().replace(row.path.name, row.checkpoint)
        (partial / "README.md").write_text(card + _measured(row, config))
        os.replace(partial, path)


def _measured(row: Any, config: SourcePoliciesConfig) -> str:
    """What the card says of a chosen checkpoint."""
    last, task = config.seed_start + row.n - 1, chosen_task(config.task)
    done, lasting = round(getattr(row, task.success) * row.n), ""
    if "success_at_end" in task.score_names:
        lasting = f", still there one second later in {round(row.success_at_end * row.n)}"
    return (
        f"\nChosen among {len(config.candidates)} candidates of its training seed, on the xArm6, validation seeds "
        f"{config.seed_start} to {last}:\ndone ({task.success}) in {done} of {row.n} episodes, "
        f"{row.length:.0f} steps on average{lasting}.\n"
    )


def log_validation(table: "pd.DataFrame", config: SourcePoliciesConfig) -> None:
    """Validation scores and the published checkpoints, one W&B run per seed."""
    from benchmark.artifacts.wandb_run import log_checkpoint, start_experiment

    names = chosen_task(config.task).headline
    for seed, rows in table.groupby("seed"):
        with start_experiment(config.wandb, f"seed{seed}", str(config.folder), "validate", asdict(config)) as run:
            for row in rows.sort_values("step").itertuples():
                run.log({f"validation/{name}": getattr(row, name) for name in names}, step=row.step)
            for name in rows.checkpoint[rows.checkpoint != ""]:
                log_checkpoint(run, config.folder / name)


def markdown(table: "pd.DataFrame", config: SourcePoliciesConfig) -> str:
    """All candidates as a document."""
    import numpy as np

    from benchmark.artifacts.commit import commit
    from benchmark.scoring.scores import with_interval
    from benchmark.scoring.statistics import rate_interval

    task = chosen_task(config.task)
    names, rank = sorted(task.score_names), ", then ".join([*task.headline, "length"])
    shown = table.assign(length=table.length.round(1), hash=table.hash.str[:12])
    for name in names:
        bounds = [rate_interval(np.full(n, mean)) for mean, n in zip(table[name], table.n, strict=True)]
        shown = shown.assign(**{f"{name}_low": [b[0] for b in bounds], f"{name}_high": [b[1] for b in bounds]})
    shown = shown.assign(**{name: [with_interval(row, name) for _, row in shown.iterrows()] for name in names})
    last = config.seed_start + config.episodes - 1
    command = f"python -m benchmark.source_policies task={config.task} recipe={config.recipe}"
    return "\n".join(
        [
            f"# Candidates for `{config.task}`, recipe `{config.recipe}`",
            "",
            f"Made by `{command}`, commit {commit()}.",
            f"xArm6, setting embodied, validation seeds {config.seed_start} to {last}; percent with 95 % Wilson",
            f"intervals. The best of each seed by {rank} are published under `checkpoint`. Their",
            "figures here are those of a choice, hence too good: test seeds decide.",
            "",
            shown[["seed", "step", "checkpoint", "n", *names, "length", "hash"]].to_markdown(index=False),
            "",
        ]
    )
