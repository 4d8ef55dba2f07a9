"""Settings that several commands share: names, defaults, units and what is allowed."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.settings.chosen_scales import USUAL_FOLDER, chosen_scales, scales_file
from benchmark.settings.limits import memory
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.recipe import USUAL, check_recipe
from benchmark.settings.robot_config import ArmConfig, RobotConfig, robot_field
from benchmark.settings.scenes import VALIDATION, check_scenes
from benchmark.settings.setting import SettingError, check_choice, check_counts, check_setting
from benchmark.settings.task import chosen_task
from policies.methods import BY_TASK, DIRECT, GUIDED, METHODS, in_task, said_of_each
from richmap.robots import ROBOTS, SETTINGS

if TYPE_CHECKING:
    from envs.task import Task

ORACLE_METHODS = {"plain": "plain_oracle", "aware": "aware_oracle"}
"""Scripted oracles (`envs.block_push.oracle`, `envs.block_push.aware_oracle`), and what stands in the column `method`
of their episodes."""

ORACLES = tuple(ORACLE_METHODS)

CLASS_IN_FILE = r".+\.py:\w+"
"""How a class in a file is written."""


@dataclass
class ConditionConfig:
    """A condition of a suite: an arm, and how it stands and is limited."""

    robot: str = "ur3"
    """One of those that ship."""
    task: str = ""
    """What is to be done there; empty for what the suite says once for all conditions."""
    setting: str = "embodied"
    """What it may do (see benchmark.run)."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    cause: str = ""
    """What direct transfer fails by there, for people."""
    saturated: bool = False
    """Whether direct transfer lacks next to nothing there: it shows harm, and counts for no share of head-room."""

    def __post_init__(self) -> None:
        check_choice("robot", self.robot, ROBOTS)
        check_choice("setting", self.setting, SETTINGS)


@dataclass(unsafe_hash=True)
class WandbConfig:
    """Whether runs are logged in Weights & Biases, and where."""

    mode: str = "disabled"
    """online, offline (kept on disk, for `wandb sync`) or disabled."""
    project: str = "guided-push"
    """Project that the runs go to."""
    folder: str = "outputs"
    """Folder that gets a folder `wandb`."""
    group: str = ""
    """What the runs belong to; empty for the sweep's folder, or else the output folder."""
    video: bool = True
    """Whether the first episode of an evaluation is logged as a GIF, true or false."""

    def __post_init__(self) -> None:
        modes = ("online", "offline", "disabled")
        check_choice("wandb.mode", self.mode, modes)
        if self.mode != "disabled":
            check_folder(self.folder, "wandb.folder")


@dataclass(unsafe_hash=True)
class LimitsConfig:
    """What a class of guidance from a file may take; its process is ended beyond that."""

    seconds: float = 300.0
    """Time for its answers to a batch of episodes, in s of the clock; from 1 to 86400."""
    memory: float = 4.0
    """Resident memory of its process, in GB; from 0.5 to what the machine has."""

    def __post_init__(self) -> None:
        check_setting(1 <= self.seconds <= 86400, "limits.seconds", self.seconds, "a number from 1 to 86400")
        most = f"a number from 0.5 to {memory():.0f}, what this machine has"
        check_setting(0.5 <= self.memory <= memory(), "limits.memory", self.memory, most)


def unfit(method: str, task: "Task") -> str:
    """Why a method cannot act in a task, in words; empty if it can."""
    if (method := in_task(method, task.name)) not in METHODS:
        return f"it is for {' and '.join(BY_TASK[method])} alone" if method in BY_TASK else ""
    if why := METHODS[method].refusal(task.space):
        return why
    if METHODS[method].imagines and task.model is None:
        return f"it imagines episodes, and {task.name} has no model to do that with"
    asks = METHODS[method].follows and task.controller is None
    return f"it asks the arm's own controller, and {task.name} says of none" if asks else ""


def check_method(name: str, setting: str, methods: Iterable[str], task: "Task") -> None:
    """Raise `SettingError` unless this is one of these methods and acts in the task, or a class in a file that is
    there."""
    if not re.fullmatch(CLASS_IN_FILE, name):
        check_setting(name in methods, setting, name, f"{', '.join(methods)}, or a class in a file, as in mine.py:Mine")
    elif not Path(file := name.rpartition(":")[0]).is_file():
        raise SettingError(f"{setting}={name}: there is no file {file}.")
    if why := unfit(name, task):
        raise SettingError(f"{setting}={name}: {why}.")


@dataclass
class RunConfig:
    """Rolls out the xArm6's policy on an arm, without guidance and with it, on the same episodes, and compares."""

    robot: RobotConfig = robot_field("ur3")
    """Arm that acts: one that ships (xarm6 is the source itself), or custom."""
    task: str = "block_push"
    """What is to be done: block_push, press_buttons, or a task of your own as module:NAME (an `envs.task.Task`; its
    code is run)."""
    guidance_scale: float | None = field(default=None, metadata={"more": said_of_each("scale")})
    """Scale of the method, any number >= 0; 0 is direct transfer, null the one that benchmark.choose_scales
    chose for this method and task, on validation episodes of all conditions of a suite; of a class in a file, its
    default_scale."""
    method: str = field(default="", metadata={"more": said_of_each("text")})
    """Guidance, or direct for none, or a subclass of policies.guidance.Guidance in a file, as in path/to/mine.py:Mine
    (its code is run, in a process of its own); or plain_oracle or aware_oracle, scripted ones in place of a policy.
    Empty: paper if lambda is given, otherwise direct."""
    suite: str = ""
    """Conditions on all of which the method is rolled out, at its chosen scale, in place of robot, setting and arm:
    quick (five conditions and one policy, for a first look), all-v1 (twenty conditions of both tasks), full (these on
    the scenes of the ranking), push-v1 (block push), buttons-v1 (pressing buttons) or official (the paper's four arms,
    embodied and best); a file of conf/suite each."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """With suite=: training seeds of the policies, in place of seed."""
    conditions: dict[str, ConditionConfig] = field(default_factory=dict)
    """Of the suite, by name."""
    episodes: int = 50
    """Number of episodes per lambda; a whole number >= 1."""
    recipe: str = USUAL
    """What the policy learned from: robust (episodes most of which are disturbed on purpose) or clean (undisturbed
    episodes alone, as in the paper)."""
    seed: int = 42
    """Training seed of the policy, a whole number >= 0."""
    checkpoint: int = 1
    """Which of that seed's checkpoints, by rank on the validation episodes, from 1: seed<seed>-<checkpoint>, of other
    recipes than robust with the recipe's name before that; the one that ships, or else the one that
    benchmark.source_policies or benchmark.train left in outputs."""
    policy: str = ""
    """Folder of a LeRobot checkpoint to run instead, of any type that sees states or pictures; empty for the one that
    recipe, seed and checkpoint pick. One that is not of type guided_push samples as it was saved (not by sampler), and
    only with lambda=0."""
    setting: str = "embodied"
    """What the arm may do: embodied (joint limits and self-collision bind) or original (neither does, as where only the
    arm is swapped in the original task) or best (as embodied, with the base where benchmark.studies.place_bases finds
    the arm to reach the most)."""
    scales_dir: str = USUAL_FOLDER
    """With lambda=null: the folder of <task>.yaml, which holds the chosen scale of each method; that of results/scales
    is the one that ships, where there is none."""
    output_dir: str = "results"
    """Folder that results go to, such as episodes."""
    device: str = "auto"
    """Where the policy runs: cpu, cuda, or auto (cuda if there is one)."""
    seed_start: int = VALIDATION.start
    """Seed of the first episode: from 50000 to 59999 are validation episodes, for every choice; from 100000 on test
    episodes, for final figures: protocol=paper takes 50 from 100000 on, tables those from 150000 to 150099, and
    suite=full those from 160000 to 160099 (docs/protocol.md)."""
    sampler: str = "DDIM"
    """Sampler of the diffusion policy: DDIM or DDPM."""
    sampling_steps: int = 10
    """Denoising steps per action chunk; a whole number from 1 to 100."""
    batch_size: int = 10
    """Rows of the batch in which the policy is evaluated; an episode's row and this number are stored with it, since
    float results depend on the batch's shape. A whole number >= 1."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    wandb: WandbConfig = field(default_factory=WandbConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)

    def __post_init__(self) -> None:
        self.method = self.method or ("paper" if self.guidance_scale else DIRECT)
        if self.guidance_scale is None and self.method in (DIRECT, *ORACLE_METHODS.values()):
            self.guidance_scale = 0.0
        scale = self.guidance_scale
        self.conditions = {name: replace(each, task=each.task or self.task) for name, each in self.conditions.items()}
        tasks = [chosen_task(name) for name in self.tasks]
        for_any = next((task for task in tasks if not unfit(self.method, task)), tasks[0])
        check_method(self.method, "method", [*METHODS, *BY_TASK, *ORACLE_METHODS.values()], for_any)
        check_setting(bool(self.conditions) or not self.suite, "suite", self.suite, "a file of conf/suite")
        if scale is not None:
            check_setting(math.isfinite(scale) and scale >= 0, "lambda", scale, "any number >= 0, or null")
            guided = self.method not in (DIRECT, *ORACLE_METHODS.values())
            check_setting(scale == 0 or guided, "lambda", scale, f"0 with method={self.method}")
        if scale is not None and self.method in METHODS and METHODS[self.method].counts:
            check_setting(scale == int(scale), "lambda", scale, f"a whole number of samples with method={self.method}")
        check_counts(self, "episodes", "batch_size", "workers", "checkpoint")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_recipe(self.recipe)
        covered = scale == 0 or self.map.half_width >= 0.8
        check_setting(covered, "map.half_width", self.map.half_width, "0.8 or more, so that the field covers the table")
        check_scenes(self.seed_start, self.episodes, self.suite)
        check_folder(self.output_dir)
        check_choice("setting", self.setting, SETTINGS)
        check_choice("device", self.device, ("cpu", "cuda", "auto"))
        check_choice("sampler", self.sampler, ("DDIM", "DDPM"))
        steps = self.sampling_steps
        check_setting(1 <= steps <= 100, "sampling_steps", steps, "a whole number from 1 to 100")

    @property
    def tasks(self) -> list[str]:
        """What is done: on the conditions of a suite, each once, or the one task."""
        return [*dict.fromkeys(each.task for each in self.conditions.values())] or [self.task]

    @property
    def parts(self) -> "list[RunConfig]":
        """A run for each task, with the method that a rule is there. Of several, each has a folder of its own in
        `output_dir`; in a task in which the method does not act (`idle`), its part is direct transfer, unless it acts
        in none."""
        parts, acts = [], not all(self.idle(name) for name in self.tasks)
        for name in self.tasks:
            given: dict[str, Any] = {"method": in_task(self.method, chosen_task(name).name)}
            if acts and self.idle(name):
                given = {"method": DIRECT, "guidance_scale": 0.0}
            if len(self.tasks) > 1:
                given["output_dir"] = str(Path(self.output_dir, chosen_task(name).name))
            conditions = {key: each for key, each in self.conditions.items() if each.task == name}
            parts.append(replace(self, task=name, conditions=conditions, **given))
        return parts

    def idle(self, task: str) -> str:
        """Why the method does not act in a task, in words: it cannot, or no scale of it was chosen; empty if it
        does."""
        if why := unfit(self.method, chosen_task(task)):
            return why
        name = chosen_task(task).name
        method = in_task(self.method, name)
        lacks = self.guidance_scale is None and method in GUIDED and method not in chosen_scales(self.scales_dir, name)
        return f"{scales_file(self.scales_dir, name)} has no scale of {method}" if lacks else ""


@dataclass
class OracleConfig:
    """Rolls out the scripted oracle on an arm: what the task allows there without a learned policy."""

    robot: RobotConfig = robot_field("ur3")
    """Arm: one that ships, or custom."""
    task: str = "block_push"
    """What is to be done: block_push, press_buttons, or a task of your own as module:NAME (an `envs.task.Task`; its
    code is run)."""
    setting: str = "embodied"
    """What the arm may do: original, embodied or best (see benchmark.run)."""
    oracle: str = "plain"
    """Which oracle: plain (the original's, blind to the arm) or aware (a planner, which pushes from where the arm can
    be)."""
    episodes: int = 300
    """Number of episodes; a whole number >= 1."""
    seed_start: int = VALIDATION.start
    """Seed of the first episode."""
    output_dir: str = "outputs/oracle"
    """Folder of <robot>-<setting>/episodes (with what of the arm is changed, as ur10-embodied-wrist_out)."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)

    def __post_init__(self) -> None:
        chosen_task(self.task)
        check_counts(self, "episodes", "workers")
        check_scenes(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        check_choice("oracle", self.oracle, ORACLES)
        check_choice("setting", self.setting, SETTINGS)
