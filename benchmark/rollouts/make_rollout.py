"""What is rolled out, from the settings of `benchmark.run`: the condition with the policy, the arm and the field."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.artifacts.fields import guidance_field
from benchmark.episodes.arm import chosen_arm
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.make_condition import make_condition
from benchmark.settings.config import CLASS_IN_FILE, RunConfig
from benchmark.settings.task import chosen_task
from policies.methods import DIRECT, METHODS

if TYPE_CHECKING:
    from rich.console import Console

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

    @cached_property
    def in_branch(self) -> Path | None:
        """The map by which the method keeps the arm off obstacles, if it does so by one; built like the field."""
        c, method = self.config, METHODS[self.config.method]
        if method.field != "branch_reach" or not method.keeps_off(self.arm.obstacles):
            return None
        return guidance_field("branch_map", self.arm, c.map, c.energy, c.workers, self.console)[1]

    @cached_property
    def entry(self) -> Entry | None:
        """What a method that is a class in a file is run as."""
        c = self.config
        return Entry.of_class(c.method, c.limits) if re.fullmatch(CLASS_IN_FILE, c.method) else None

    def rollout(self, scale: float) -> "Rollout":
        """What is rolled out there at a scale; direct transfer at 0."""
        from benchmark.rollouts.rollout import Rollout

        if scale and self.entry:
            return self.entry.at(scale).rollout(self.config, self.task, self.arm, self.checkpoint, self.console)
        if not scale:
            condition = make_condition(self.config, self.task, self.arm, DIRECT, scale, self.checkpoint, None)
            return Rollout(self.task, self.arm, condition, self.checkpoint, None)
        method, (field, file) = METHODS[self.config.method], self.field
        condition = make_condition(self.config, self.task, self.arm, method.name, scale, self.checkpoint, field)
        return Rollout(
            self.task, self.arm, condition, self.checkpoint, file, kind=method.field, in_branch=self.in_branch
        )


def set_stage(config: RunConfig, checkpoint: Path, console: "Console") -> Stage:
    """The stage of a run's settings."""
    task = chosen_task(config.task)
    return Stage(config, task, chosen_arm(config, task), checkpoint, console)


def make_rollout(config: RunConfig, scale: float, checkpoint: Path, console: "Console") -> "Rollout":
    """What is rolled out at one lambda; builds the field if one is needed and not in the cache."""
    return set_stage(config, checkpoint, console).rollout(scale)
