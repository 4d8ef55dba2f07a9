"""Choosing one scale of a method for a task: a grid with "off" in it, on a few scenes of every condition of a suite."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from benchmark.settings.chosen_scales import USUAL_FOLDER, chosen_scales, scales_file
from benchmark.settings.config import RunConfig, unfit
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.scenes import VALIDATION
from benchmark.settings.setting import check_choice, check_setting
from benchmark.settings.suite import suite_conditions, tasks_of
from benchmark.settings.task import chosen_task
from policies.methods import GUIDED, METHODS, SWEPT

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.rollouts.make_rollout import Stage

BUDGET = 1500
"""Most validation episodes of a method, "off" among them."""


@dataclass
class ChooseScalesConfig:
    """Chooses the scale of each method for each task of a suite, the same on all its conditions, on
    validation scenes."""

    suite: str = "push-v1"
    """On whose conditions (see benchmark.run)."""
    methods: list[str] | None = None
    """Methods, as in methods=[paper,towards] (see benchmark.run); null for those that need no more of the arm than a
    field and act in a task of the suite."""
    points: int = 9
    """Most scales of a method besides off, each twice the one before; from 1 to 16."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of the policies."""
    seed_start: int = 51_000
    """Seed of the first scene, a validation scene; the same scenes on all conditions."""
    scales_dir: str = USUAL_FOLDER
    """Folder of <task>.yaml, which the chosen scales are written into."""
    output_dir: str = "outputs/scale_choice"
    """Folder that the episodes go to."""
    device: str = "cpu"
    """Where the policy runs (see benchmark.run)."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        tasks = [chosen_task(name) for name in tasks_of(suite_conditions(self.suite))]
        if self.methods is None:
            self.methods = [name for name in SWEPT if not all(unfit(name, task) for task in tasks)]
        for name in self.methods or ["[]"]:
            check_choice("methods", name, GUIDED)
        check_setting(1 <= self.points <= 16, "points", self.points, "a whole number from 1 to 16")
        check_folder(self.scales_dir, "scales_dir")
        for run in (run for name in self.methods for run in self.runs(name)):
            inside = self.seed_start in VALIDATION and self.seed_start + run.episodes - 1 in VALIDATION
            check_setting(
                inside, "seed_start", self.seed_start, f"validation scenes, {VALIDATION[0]} to {VALIDATION[-1]}"
            )

    def runs(self, method: str) -> list[RunConfig]:
        """Settings of a method's rollouts in each of the suite's tasks in which it acts: of each condition, policy and
        scale as many scenes as the budget has."""
        names = {each.name for each in fields(RunConfig)}
        given = {name: getattr(self, name) for name in vars(self) if name in names}
        whole = RunConfig(method=method, guidance_scale=0.0, conditions=suite_conditions(self.suite), **given)
        parts = [part for part in whole.parts if not whole.idle(part.task)]
        rows = [(self.points + 1) * len(part.conditions) * len(self.seeds) for part in parts]
        scenes = [max(1, BUDGET // each) for each in rows]
        return [replace(part, episodes=n, batch_size=n) for part, n in zip(parts, scenes, strict=True)]

    def budget_text(self, run: RunConfig) -> str:
        """What the choice in a task costs at most."""
        points = f"{self.points + 1} scales x {len(run.conditions)} conditions x {len(self.seeds)} policies"
        of_method = (self.points + 1) * len(run.conditions) * len(self.seeds) * run.episodes
        return f"{points} x {run.episodes} scenes: at most {of_method} episodes of a method; those of off are shared."


def choose(config: ChooseScalesConfig, run: RunConfig, console: "Console") -> dict[str, Any]:
    """The scale that does best over all conditions of a task, of equal ones the smallest, and what each came to."""
    from benchmark.artifacts.commit import commit
    from benchmark.rollouts.missing_episodes import play_and_store

    stages, scales = _stages(run, console), [0.0, *METHODS[run.method].scales(config.points)]
    rollouts = [stage.rollout(scale) for scale in scales for stage in stages]
    tables = play_and_store(rollouts, run, console, run.method)
    scores = np.array([table[stages[0].task.ranking[0]].mean() for table in tables]).reshape(len(scales), -1).mean(1)
    tried = {scale: round(float(score), 4) for scale, score in zip(scales, scores, strict=True)}
    best = max(tried, key=lambda scale: (tried[scale], -scale))
    about = {"suite": config.suite, "episodes_per_scale": len(stages) * run.episodes, "commit": commit()}
    version = max(stage.task.episode_version(stage.arm.setting) for stage in stages)
    return {"scale": best, "tried": tried, **about, "episode_version": version}


def written(run: RunConfig, chosen: dict[str, Any]) -> Path:
    """Put a method's choice into the task's file, and leave the others there."""
    from richmap.outputs import replacing

    file = scales_file(run.scales_dir, chosen_task(run.task).name)
    said = chosen_scales(run.scales_dir, chosen_task(run.task).name) | {run.method: chosen}
    with replacing(file) as path:
        path.write_text("# Made by python -m benchmark.choose_scales.\n" + yaml.safe_dump(said, sort_keys=True))
    return file


def _stages(run: RunConfig, console: "Console") -> "list[Stage]":
    from benchmark.artifacts.known_policies import checkpoint_folder
    from benchmark.episodes.arm import chosen_arms
    from benchmark.rollouts.make_rollout import Stage

    task = chosen_task(run.task)
    checkpoints = [checkpoint_folder(seed, task=run.task) for seed in run.seeds]
    arms = chosen_arms(run, task)
    return [Stage(run, task, arm, checkpoint, console) for arm in arms for checkpoint in checkpoints]
