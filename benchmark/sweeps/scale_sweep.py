"""Scale sweep."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING

from benchmark.artifacts.fields import guidance_field
from benchmark.episodes.arm import arm_name, chosen_arm
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.scoring.scale_table import CHOSEN_FOR
from benchmark.settings.config import LimitsConfig, RunConfig, check_method
from benchmark.settings.limits import EPISODE_SECONDS
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.recipe import USUAL
from benchmark.settings.robot_config import ArmConfig, RobotConfig, robot_field
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.task import chosen_task
from policies.method import MOST_SAMPLES
from policies.methods import GUIDED, METHODS, SWEPT
from richmap.progress import number_of

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.rollout import Rollout
    from envs.task import Task
    from policies.guidance import Guidance
    from richmap.similarity.load_field import StoredField
    from richmap.task_spaces.task_space import TaskSpace


COLLAPSE = 0.5
"""A method's sweep ends when the score that ranks falls below this part of direct transfer's."""


@dataclass
class ScalesConfig:
    """Sweeps the scale of each method of guidance on an arm, on validation episodes and up to collapse."""

    robot: RobotConfig = robot_field("ur3")
    """Arm that acts (see benchmark.run)."""
    task: str = "block_push"
    """What is to be done (see benchmark.run)."""
    methods: list[str] = field(default_factory=lambda: [*SWEPT])
    """Methods, as in methods=[paper,towards], or a class in a file, as in methods=[path/to/mine.py:Mine] (see
    benchmark.run)."""
    scale: list[float] = field(default_factory=list)
    """Scales to try of each method, as in scale=[0.1,0.2], instead of doubled ones; empty for those, which begin at the
    method's first, or an eighth of a class's default_scale."""
    points: int = 9
    """Most scales of a method, each twice the one before; it ends sooner when the policy collapses. From 1 to 16."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds, whole numbers >= 0; one checkpoint of each is rolled out."""
    recipe: str = USUAL
    """What the policies learned from (see benchmark.run)."""
    checkpoint: int = 1
    """Which of each seed's checkpoints, by rank on the validation episodes, from 1."""
    episodes: int = 50
    """Number of episodes per scale and checkpoint; a whole number >= 1. The same ones for all."""
    seed_start: int = 50_000
    """Seed of the first episode: choices are made on validation episodes, 50000 to 59999."""
    setting: str = "embodied"
    """What the arm may do (see benchmark.run)."""
    output_dir: str = "results/scales"
    """In its folder <recipe>/<arm>-<setting> (with what of the arm is changed, as ur10-embodied-wrist_out): scales.md,
    figures, and each method's episodes in a folder."""
    device: str = "auto"
    """Where the policy runs: cpu, cuda, or auto (cuda if there is one)."""
    sampler: str = "DDIM"
    """Sampler of the diffusion policy: DDIM or DDPM."""
    sampling_steps: int = 10
    """Denoising steps per action chunk; a whole number from 1 to 100."""
    batch_size: int = 50
    """Rows of the batch in which the policy is evaluated (see benchmark.run); a whole number >= 1."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)

    def __post_init__(self) -> None:
        for name in self.methods or ["[]"]:
            check_method(name, "methods", SWEPT, chosen_task(self.task))
        for scale in self.scale:
            check_setting(math.isfinite(scale) and scale > 0, "scale", scale, "numbers above 0")
        check_setting(1 <= self.points <= 16, "points", self.points, "a whole number from 1 to 16")
        check_setting(bool(self.seeds), "seeds", self.seeds, "one or more whole numbers")
        validation = 50_000 <= self.seed_start <= 60_000 - self.episodes
        check_setting(validation, "seed_start", self.seed_start, "from 50000 to 60000 - episodes, validation episodes")
        for seed in self.seeds:
            self.run(seed)

    @property
    def folder(self) -> Path:
        """Of the recipe's policies on the arm."""
        run = self.run(self.seeds[0])
        return Path(self.output_dir) / self.recipe / arm_name(chosen_arm(run, chosen_task(self.task)))

    def run(self, seed: int) -> RunConfig:
        """Settings of direct transfer with the policy of one training seed."""
        names = {each.name for each in fields(RunConfig)} - {"seed"}
        return RunConfig(**{name: value for name, value in vars(self).items() if name in names}, seed=seed)


@dataclass(frozen=True)
class Swept:
    """A method whose scale is swept: one of ours, or a class in a file."""

    name: str
    scales: tuple[float, ...]
    """Smallest first, without those beyond what is asked."""
    unit: str
    """What its scale is."""
    kind: str | None
    """Of the field that it looks at."""
    field: "StoredField | None" = None
    path: Path | None = None
    """Of that field."""
    guidance: GuidanceClass | None = None
    """The class."""

    def make(self, scale: float, base: tuple[float, float], seed: int, space: "TaskSpace") -> "Guidance":
        """The method as it acts."""
        if self.guidance:
            return self.guidance.make(scale, self.path, base, seed, space.action.width)
        from policies.setup import Setup

        return METHODS[self.name].make(Setup(scale, self.field, base, seed, space))


def swept_methods(config: ScalesConfig, console: "Console") -> list[Swept]:
    """What is swept, with fields; those of one kind are built once.

    Raises:
        SettingError: If two are called alike, or it is not known where the scales of a class begin.
    """
    arm = chosen_arm(config.run(config.seeds[0]), chosen_task(config.task))
    found = [_swept(config, method) for method in config.methods]
    names = [each.name for each in found]
    check_setting(len({*names}) == len(names), "methods", names, "names of their own")
    settings = config.map, config.energy, config.workers, console
    fields = [guidance_field(each.kind, arm, *settings) for each in found]
    return [replace(each, field=field, path=path) for each, (field, path) in zip(found, fields, strict=True)]


def _swept(config: ScalesConfig, method: str) -> Swept:
    if method in METHODS:
        ours = METHODS[method]
        return Swept(method, tuple(sorted(config.scale) or ours.scales(config.points)), ours.scale, ours.field)
    entry = Entry.of_class(method, config.limits)
    if not config.scale and not entry.default_scale:
        raise SettingError(f"{method} names no default_scale. Give it one, or give scale=[0.1,0.2].")
    first = (entry.default_scale or 0.0) / 8
    scales = sorted(config.scale) or [first * 2**k for k in range(config.points)]
    guidance, about = entry.guidance(config.limits, Path(config.output_dir)), entry.about
    return Swept(about.name, tuple(scales), "in the class's own unit", entry.kind, guidance=guidance)


def budget(config: ScalesConfig, methods: list[Swept]) -> str:
    """What the sweep costs at most."""
    points = 1 + sum(len(method.scales) for method in methods)
    episodes = points * len(config.seeds) * config.episodes
    minutes = math.ceil(episodes * EPISODE_SECONDS / config.workers / 60)
    return (
        f"At most {points} points (direct transfer and {number_of('method', len(config.methods))}) x "
        f"{len(config.seeds)} checkpoints x {config.episodes} episodes = {episodes} episodes; at about "
        f"{EPISODE_SECONDS:g} s each on {config.workers} workers {number_of('minute', minutes)}. Stored ones are kept"
        + ("." if config.scale else "; a method ends where it collapses.")
    )


def guided(direct: "Rollout", by: Swept, scale: float) -> "Rollout":
    """The same rollout with guidance."""
    version = by.guidance.version if by.guidance else ""
    condition = replace(direct.condition, method=by.name, guidance_scale=scale, entry_hash=version)
    if by.field is not None:
        fingerprint = by.field.about["fingerprint"]
        cell_size = by.field.grid.cell_size if by.field.grid else math.nan
        condition = replace(condition, field_fingerprint=fingerprint, cell_size=cell_size)
    return replace(direct, field=by.path, kind=by.kind, condition=condition, guidance=by.guidance)


def sweep(config: ScalesConfig, direct: "list[Rollout]", methods: list[Swept], console: "Console") -> "pd.DataFrame":
    """Direct transfer and then level by level the next scale of every method that has not collapsed; scales that were
    asked for are tried whatever comes out.

    Returns:
        These episodes of all methods in the arm's folder, as far as this version of the code produced them, and of
        the classes that are swept their files as they are.
    """
    reference = run_points({"direct": direct}, config, "Direct transfer", console)["direct"]
    going, levels = methods, max(len(method.scales) for method in methods)
    for level in range(levels):
        going = [method for method in going if level < len(method.scales)]
        if not going:
            break
        points = {
            method.name: [guided(rollout, method, method.scales[level]) for rollout in direct] for method in going
        }
        rates = run_points(points, config, f"Scale {level + 1} of at most {levels}", console)
        if not config.scale:
            going = [method for method in going if rates[method.name] >= COLLAPSE * reference]
    rows = read_methods(config.folder, direct[0].task, episode_seeds(config))
    versions = {method.name: method.guidance.version for method in methods if method.guidance}
    return rows[rows.entry_hash == rows.method.map(versions).fillna(rows.entry_hash)]


def episode_seeds(config: ScalesConfig) -> range:
    """The episodes of every point."""
    return range(config.seed_start, config.seed_start + config.episodes)


def read_methods(folder: Path, task: "Task", seeds: range) -> "pd.DataFrame":
    """These episodes in an arm's folder, whatever the method, of the task's present version; an empty table if none
    are."""
    import pandas as pd

    from benchmark.episodes.table import read_episodes

    tables = []
    others = sorted({each.name for each in folder.glob("*") if each.is_dir()} - {*METHODS})  # Classes in files.
    for method in (*METHODS, *others):
        table = read_episodes(folder / method)
        if len(table):
            present = table.episode_version == table.setting.map(task.episode_version)
            tables.append(table[present & table.episode_seed.isin(seeds)])
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def run_points(
    points: "dict[str, list[Rollout]]", config: ScalesConfig, name: str, console: "Console"
) -> dict[str, float]:
    """Roll out what is not stored of some methods, each with all checkpoints, and give the score that ranks."""
    from benchmark.rollouts.field_settings import note_settings
    from benchmark.rollouts.missing_episodes import play_missing

    for method, group in points.items():
        note_settings(config.folder / method, group, config.run(config.seeds[0]))
    rollouts = [rollout for group in points.values() for rollout in group]
    tables = play_missing(
        rollouts,
        episode_seeds(config),
        lambda condition: config.folder / condition.method,
        config.workers,
        name,
        console,
    )
    score_of = {rollout: table[rollout.task.ranking[0]].mean() for rollout, table in zip(rollouts, tables, strict=True)}
    return {method: mean(score_of[rollout] for rollout in group) for method, group in points.items()}


def shown(table: "pd.DataFrame", task: "Task") -> "pd.DataFrame":
    """The columns for people, in percent and points."""
    import pandas as pd

    from benchmark.scoring.guidance_figures import method_and_cells
    from benchmark.scoring.scores import difference_text, with_interval

    def points(row: "pd.Series", name: str) -> str:
        return "" if row.method == "direct" else difference_text(row, f"{name}_difference")

    rows = [row for _, row in table.iterrows()]
    return pd.DataFrame(
        {
            "method": [method_and_cells(row) for row in rows],
            "λ": [f"{row['lambda']:g}" for row in rows],
            "n": [row.n for row in rows],
            **{name: [with_interval(row, name) for row in rows] for name in task.headline},
            **{f"{name} - direct": [points(row, name) for row in rows] for name in task.headline},
        }
    )


TEXT = """# The scale of each method of guidance

Validation episodes, the same for all; percent, with 95 % intervals for other trainings and other episodes, and paired
differences to direct transfer in points. Made by `python -m benchmark.scales robot=…`. Unless scales were given, each
method's λ was doubled until its {score} fell below half of direct transfer's, or as often as was asked (nine scales by
default; methods that choose among samples end at {most} of them). The chosen one has the best {score}, of equal ones it
is the smallest. Being the best of several on these episodes, its {score} here is too high: final figures come from
other episodes.

{units}"""


def markdown(table: "pd.DataFrame", task: "Task", methods: Sequence[Swept] = ()) -> str:
    """The tables for people, an arm after the other."""
    from benchmark.episodes.arm import base_text, branch_text, setting_text

    own = {method.name: method.unit for method in methods if method.guidance}
    units = {name: METHODS[name].scale for name in GUIDED if name in {*table.method}} | own
    said = "\n".join(f"- `{name}`: λ is {unit}." for name, unit in units.items())
    parts = [TEXT.format(most=MOST_SAMPLES, units=said, score=task.ranking[0])]
    for arm, group in table.groupby(CHOSEN_FOR, sort=True):
        about = dict(zip(CHOSEN_FOR, arm, strict=True))
        parts += [
            f"## {about['robot']}, {setting_text(about)}",
            f"Base {base_text(about)} m, {branch_text(about)}, {about['sampler']}-{about['sampling_steps']}, "
            f"{group.checkpoints.max()} checkpoints. Chosen:",
            shown(group[group.chosen], task).to_markdown(index=False, disable_numparse=True),
            "All:",
            shown(group, task).to_markdown(index=False, disable_numparse=True),
        ]
    return "\n\n".join(parts) + "\n"
