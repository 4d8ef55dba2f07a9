"""Choosing one scale of a method for a task: a grid with "off" in it, on a few scenes of every condition of a suite."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from benchmark.settings.chosen_scales import read_scales, scales_file
from benchmark.settings.command import check_setting
from benchmark.settings.config import ConditionConfig, RunConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.scenes import VALIDATION
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
    """Chooses the scale of each method for a suite's task, the same on all its conditions, on validation scenes."""

    suite: str = "push-v1"
    """On whose conditions (see benchmark.run)."""
    methods: list[str] = field(default_factory=lambda: [*SWEPT])
    """Methods, as in methods=[paper,towards] (see benchmark.run)."""
    points: int = 9
    """Most scales of a method besides off, each twice the one before; from 1 to 16."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of the policies."""
    seed_start: int = 51_000
    """Seed of the first scene, a validation scene; the same scenes on all conditions."""
    scales_dir: str = "results/scales"
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
        one = len(tasks_of(self.conditions)) == 1
        check_setting(one, "suite", self.suite, "a suite of one task: a scale is chosen for a task")
        for name in self.methods or ["[]"]:
            check_setting(name in GUIDED, "methods", name, ", ".join(GUIDED))
        check_setting(1 <= self.points <= 16, "points", self.points, "a whole number from 1 to 16")
        inside = self.seed_start in VALIDATION and self.seed_start + self.episodes - 1 in VALIDATION
        check_setting(inside, "seed_start", self.seed_start, f"validation scenes, {VALIDATION[0]} to {VALIDATION[-1]}")
        check_folder(self.scales_dir, "scales_dir")
        for name in self.methods:
            self.run(name)

    @property
    def conditions(self) -> dict[str, ConditionConfig]:
        """Of the suite."""
        return suite_conditions(self.suite)

    @property
    def task(self) -> str:
        """Of the suite."""
        return tasks_of(self.conditions)[0]

    @property
    def episodes(self) -> int:
        """Scenes of each condition, policy and scale: as many as the budget has."""
        return max(1, BUDGET // ((self.points + 1) * len(self.conditions) * len(self.seeds)))

    @property
    def budget_text(self) -> str:
        """What the choice costs at most."""
        points = f"{self.points + 1} scales x {len(self.conditions)} conditions x {len(self.seeds)} policies"
        of_method = (self.points + 1) * len(self.conditions) * len(self.seeds) * self.episodes
        return f"{points} x {self.episodes} scenes: at most {of_method} episodes of a method; those of off are shared."

    def run(self, method: str) -> RunConfig:
        """Settings of a method's rollouts."""
        names = {each.name for each in fields(RunConfig)}
        given = {name: getattr(self, name) for name in (*vars(self), "task", "conditions", "episodes") if name in names}
        return RunConfig(method=method, batch_size=self.episodes, **given)


def choose(config: ChooseScalesConfig, method: str, console: "Console") -> dict[str, Any]:
    """The scale that does best over all conditions together, of equal ones the smallest, and what each came to."""
    from benchmark.artifacts.commit import commit
    from benchmark.rollouts.missing_episodes import play_and_store

    stages, scales = _stages(config, method, console), [0.0, *METHODS[method].scales(config.points)]
    rollouts = [stage.rollout(scale) for scale in scales for stage in stages]
    tables = play_and_store(rollouts, config.run(method), console, method)
    scores = np.array([table[stages[0].task.ranking[0]].mean() for table in tables]).reshape(len(scales), -1).mean(1)
    tried = {scale: round(float(score), 4) for scale, score in zip(scales, scores, strict=True)}
    best = max(tried, key=lambda scale: (tried[scale], -scale))
    about = {"suite": config.suite, "episodes_per_scale": len(stages) * config.episodes, "commit": commit()}
    version = max(stage.task.episode_version(stage.arm.setting) for stage in stages)
    return {"scale": best, "tried": tried, **about, "episode_version": version}


def written(config: ChooseScalesConfig, method: str, chosen: dict[str, Any]) -> Path:
    """Put a method's choice into the task's file, and leave the others there."""
    from richmap.outputs import replacing

    file = scales_file(config.scales_dir, chosen_task(config.task).name)
    said = read_scales(file) | {method: chosen}
    with replacing(file) as path:
        path.write_text("# Made by python -m benchmark.choose_scales.\n" + yaml.safe_dump(said, sort_keys=True))
    return file


def _stages(config: ChooseScalesConfig, method: str, console: "Console") -> "list[Stage]":
    from benchmark.artifacts.known_policies import checkpoint_folder
    from benchmark.episodes.arm import chosen_arms
    from benchmark.rollouts.make_rollout import Stage

    run, task = config.run(method), chosen_task(config.task)
    checkpoints = [checkpoint_folder(seed, task=run.task) for seed in config.seeds]
    arms = chosen_arms(run)
    return [Stage(run, task, arm, checkpoint, console) for arm in arms for checkpoint in checkpoints]
