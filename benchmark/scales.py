"""The scale of each method of guidance: swept by factors of two on validation episodes, up to collapse.

python -m benchmark.scales robot=ur3 methods=[paper,feasibility]
"""

from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING

from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import TASK_ARMS, ArmConfig, EnergyConfig, MapConfig, RobotConfig, RunConfig
from benchmark.outputs import replacing
from benchmark.recipe import USUAL
from benchmark.scale_table import CHOSEN_FOR, scale_table
from policies.methods import METHODS

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollout import Rollout
    from richmap.energy import EnergyField

FIRST = {
    "paper": 0.03125,
    "away": 0.0125,
    "towards": 0.0125,
    "shuffled": 0.03125,
    "flipped": 0.03125,
    "ring": 0.05,
    "feasibility": 0.05,
    "projection": 0.000625,
    "best_of_n_energy": 2.0,
    "best_of_n_feasibility": 2.0,
    "chunk": 0.25,
    "chunk_feasibility": 0.25,
    "reorder": 0.0025,
}
"""Each method's smallest scale, at which it does next to nothing; what it is says `policies.methods.METHODS`."""

MOST_SAMPLES = 32
"""Of methods that choose among samples: they do not collapse, but cost more and more."""

COLLAPSE = 0.5
"""A method's sweep ends when its p2 falls below this part of direct transfer's."""

EPISODE_SECONDS = 0.3
"""About what an episode on a UR3, where many last long, takes on one core; for the budget."""


@dataclass
class ScalesConfig:
    """Sweeps the scale of each method of guidance on an arm, on validation episodes and up to collapse."""

    robot: RobotConfig = field(default_factory=RobotConfig, metadata={"choices": TASK_ARMS})
    """Arm that acts: ur3, ur5, ur10 or xarm6."""
    methods: list[str] = field(default_factory=lambda: [name for name in METHODS if name != "direct"])
    """Methods, as in methods=[paper,towards] (see benchmark.run)."""
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
    figures, and each method's episodes.parquet in a folder."""
    device: str = "auto"
    """Where the policy runs: cpu, cuda, or auto (cuda if there is one)."""
    sampler: str = "DDIM"
    """Sampler of the diffusion policy: DDIM or DDPM."""
    sampling_steps: int = 10
    """Denoising steps per action chunk; a whole number from 1 to 100."""
    slots: int = 50
    """Rows of the batch in which the policy is evaluated (see benchmark.run); a whole number >= 1."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        for name in self.methods or [None]:
            check_setting(name in METHODS and name != "direct", "methods", name, ", ".join([*METHODS][1:]))
        check_setting(1 <= self.points <= 16, "points", self.points, "a whole number from 1 to 16")
        check_setting(bool(self.seeds), "seeds", self.seeds, "one or more whole numbers")
        validation = 50_000 <= self.seed_start <= 60_000 - self.episodes
        check_setting(validation, "seed_start", self.seed_start, "from 50000 to 60000 - episodes, validation episodes")
        for seed in self.seeds:
            self.run(seed)

    @property
    def folder(self) -> Path:
        """Of the recipe's policies on the arm."""
        return arm_folder(self.output_dir, self.run(self.seeds[0]))

    def run(self, seed: int) -> RunConfig:
        """Settings of direct transfer with the policy of one training seed."""
        names = {each.name for each in fields(RunConfig)} - {"seed"}
        return RunConfig(**{name: value for name, value in vars(self).items() if name in names}, seed=seed)


def main(config: ScalesConfig) -> None:
    """Print the budget, roll out every scale that is not stored yet, and write table and figures."""
    from benchmark.known_policies import checkpoint_folder

    checkpoints = [checkpoint_folder(seed, config.checkpoint, config.recipe) for seed in config.seeds]
    from rich.console import Console

    from benchmark.field_sensitivity import demonstrated_path
    from benchmark.guidance_figures import draw_fields, draw_success
    from benchmark.make_rollout import make_rollout
    from policies.guidance import make_guidance

    console, folder = Console(), config.folder
    console.print(budget(config))
    direct = [
        make_rollout(config.run(seed), 0.0, path, console) for seed, path in zip(config.seeds, checkpoints, strict=True)
    ]
    fields = method_fields(config, console)
    table = scale_table(sweep(config, direct, fields, console))
    with replacing(folder / "scales.md") as path:
        path.write_text(markdown(table))

    arm = table[(table[CHOSEN_FOR] == [getattr(direct[0].condition, name) for name in CHOSEN_FOR]).all(axis=1)]
    base = tuple(map(float, direct[0].condition.base.split()))[:2]
    guidances = {
        row.method: make_guidance(row.method, row["lambda"], fields[row.method][0], base, config.seeds[0])
        for _, row in arm[arm.chosen].iterrows()
        if row.method in config.methods
    }
    figures = {
        "success_against_scale": draw_success(arm),
        "fields": draw_fields(guidances, base, demonstrated_path(10, console)),
    }
    for name, figure in figures.items():
        for ending in ("svg", "png"):
            file = folder / "figures" / f"{name}.{ending}"
            with replacing(file) as path:
                figure.savefig(path, dpi=100)
            console.print(f"Figure: {file}", soft_wrap=True)
    console.print(shown(arm[arm.chosen]).to_markdown(index=False), soft_wrap=True, markup=False)
    console.print(f"Table: {folder / 'scales.md'}", soft_wrap=True)


def arm_folder(output_dir: str, config: RunConfig) -> Path:
    """Where the scales of a run's policies are, on its arm as it stands."""
    from benchmark.arm import arm_name, chosen_arm

    return Path(output_dir) / config.recipe / arm_name(chosen_arm(config))


def read_methods(folder: Path, seeds: range) -> "pd.DataFrame":
    """These episodes in an arm's folder, whatever the method, that the present code made; an empty table if none are.

    Raises:
        SettingError: If one was edited.
    """
    import pandas as pd

    from benchmark.code_version import code_version
    from benchmark.results import check_unedited, read_episodes

    tables = []
    for method in METHODS:
        table = read_episodes(folder / method)
        if len(table):
            table = table[(table.code_version == code_version()) & table.episode_seed.isin(seeds)]
            check_unedited(table, folder / method / "episodes.parquet")
            tables.append(table)
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def scales(method: str, points: int) -> list[float]:
    """The scales of a method that are tried, smallest first."""
    from policies.methods import METHODS

    doubled = [FIRST[method] * 2**k for k in range(points)]
    return [scale for scale in doubled if scale <= MOST_SAMPLES or not METHODS[method].counts]


def budget(config: ScalesConfig) -> str:
    """What the sweep costs at most."""
    points = 1 + sum(len(scales(method, config.points)) for method in config.methods)
    episodes = points * len(config.seeds) * config.episodes
    hours = episodes * EPISODE_SECONDS / config.workers / 3600
    return (
        f"At most {points} points (direct transfer and {len(config.methods)} methods) x {len(config.seeds)} "
        f"checkpoints x {config.episodes} episodes = {episodes} episodes; at about {EPISODE_SECONDS:g} s each on "
        f"{config.workers} workers {hours:.1f} hours. Stored ones are kept; a method ends where it collapses."
    )


def method_fields(config: ScalesConfig, console: "Console") -> "dict[str, tuple[EnergyField | None, Path | None]]":
    """The field that each method looks at, and its file; those of one kind are built once."""
    from benchmark.arm import chosen_arm
    from benchmark.make_rollout import guidance_field
    from policies.methods import METHODS

    run = config.run(config.seeds[0])
    arm = chosen_arm(run)
    of_kind = cache(lambda kind: guidance_field(kind, arm, run, console))
    return {method: of_kind(METHODS[method].field) for method in config.methods}


def guided(direct: "Rollout", method: str, scale: float, field: "EnergyField | None", path: Path | None) -> "Rollout":
    """The same rollout with guidance."""
    condition = replace(direct.condition, method=method, guidance_scale=scale)
    if field is not None:
        fingerprint, cell_size = field.about["fingerprint"], field.grid.cell_size
        condition = replace(condition, field_fingerprint=fingerprint, cell_size=cell_size)
    return replace(direct, field=path, condition=condition)


def sweep(
    config: ScalesConfig,
    direct: "list[Rollout]",
    fields: "dict[str, tuple[EnergyField | None, Path | None]]",
    console: "Console",
) -> "pd.DataFrame":
    """Direct transfer and then level by level the next scale of every method that has not collapsed.

    Returns:
        These episodes of all methods in the arm's folder, as far as this version of the code produced them.
    """
    reference = run_points({"direct": direct}, config, "Direct transfer", console)["direct"]
    going = {method: scales(method, config.points) for method in config.methods}
    for level in range(config.points):
        points = {
            method: [guided(rollout, method, values[level], *fields[method]) for rollout in direct]
            for method, values in going.items()
            if level < len(values)
        }
        rates = run_points(points, config, f"Scale {level + 1} of at most {config.points}", console)
        going = {method: going[method] for method, rate in rates.items() if rate >= COLLAPSE * reference}
    return read_methods(config.folder, episode_seeds(config))


def episode_seeds(config: ScalesConfig) -> range:
    """The episodes of every point."""
    return range(config.seed_start, config.seed_start + config.episodes)


def run_points(
    points: "dict[str, list[Rollout]]", config: ScalesConfig, name: str, console: "Console"
) -> dict[str, float]:
    """Roll out what is not stored of some methods, each with all checkpoints, and give their p2."""
    from benchmark.field_settings import note_settings
    from benchmark.missing_episodes import run_missing
    from benchmark.rollout import roll_out_all

    for method, group in points.items():
        note_settings(config.folder / method, group, config.run(config.seeds[0]))
    rollouts = [rollout for group in points.values() for rollout in group]
    tables = run_missing(
        [rollout.condition for rollout in rollouts],
        episode_seeds(config),
        lambda condition: config.folder / condition.method,
        lambda missing: roll_out_all(zip(rollouts, missing, strict=True), config.workers),
        name,
        console,
    )
    p2_of = {rollout: table.p2.mean() for rollout, table in zip(rollouts, tables, strict=True)}
    return {method: mean(p2_of[rollout] for rollout in group) for method, group in points.items()}


def with_scale(config: RunConfig) -> RunConfig:
    """The same settings with the scale that was chosen on validation episodes, if they leave it open.

    Raises:
        SettingError: If none was chosen.
    """
    if config.guidance_scale is not None:
        return config
    if config.method == "direct":
        return replace(config, guidance_scale=0.0)
    return replace(config, guidance_scale=chosen_scale(config))


def chosen_scale(config: RunConfig) -> float:
    """The scale of the settings' method that was chosen for their arm and field, in `config.scales_dir`.

    Raises:
        SettingError: If none was.
    """
    from rich.console import Console

    from benchmark.arm import chosen_arm
    from benchmark.known_policies import chosen_checkpoint
    from benchmark.make_rollout import guidance_field, make_rollout

    console, direct = Console(quiet=True), replace(config, guidance_scale=0.0)
    condition = make_rollout(direct, 0.0, chosen_checkpoint(direct), console).condition
    arm = tuple(getattr(condition, name) for name in CHOSEN_FOR)
    folder = arm_folder(config.scales_dir, config)
    chosen = _chosen(folder).get((*arm, config.method), {})
    if chosen:
        field, _ = guidance_field(METHODS[config.method].field, chosen_arm(config), config, console)
        fingerprint = field.about["fingerprint"] if field else ""
        if fingerprint in chosen:
            return chosen[fingerprint]
    raise SettingError(
        f"lambda=null: {folder} has no scale of method={config.method} for {config.robot.name}, "
        f"{config.setting}{' with the field of these settings' if chosen else ''}. Choose one: python -m "
        f"benchmark.scales robot={config.robot.name} setting={config.setting} recipe={config.recipe} "
        f"methods=[{config.method}] output_dir={config.scales_dir} (and arm.… as here), or give lambda."
    )


@cache
def _chosen(folder: Path) -> dict[tuple, dict[str, float]]:
    """The chosen scales by arm and method, and by field, from the validation episodes of the present code."""
    episodes = read_methods(folder, range(50_000, 60_000))
    if episodes.empty:
        return {}
    table, chosen = scale_table(episodes), {}
    for row in table[table.chosen].to_dict("records"):
        of_method = chosen.setdefault(tuple(row[name] for name in [*CHOSEN_FOR, "method"]), {})
        of_method[row["field_fingerprint"]] = row["lambda"]
    return chosen


def shown(table: "pd.DataFrame") -> "pd.DataFrame":
    """The columns for people, in percent and points."""
    import pandas as pd

    from benchmark.guidance_figures import method_and_cells
    from benchmark.scores import difference_text, with_interval

    def points(row: "pd.Series", name: str) -> str:
        return "" if row.method == "direct" else difference_text(row, f"{name}_difference")

    rows = [row for _, row in table.iterrows()]
    return pd.DataFrame(
        {
            "method": [method_and_cells(row) for row in rows],
            "λ": [f"{row['lambda']:g}" for row in rows],
            "n": [row.n for row in rows],
            **{name: [with_interval(row, name) for row in rows] for name in ("p2", "score")},
            **{f"{name} - direct": [points(row, name) for row in rows] for name in ("p2", "score")},
        }
    )


TEXT = """# The scale of each method of guidance

Validation episodes, the same for all; percent, with 95 % intervals for other trainings and other episodes, and paired
differences to direct transfer in points. Made by `python -m benchmark.scales robot=…`. Each method's λ was doubled
until its p2 fell below half of direct transfer's, or as often as was asked (nine scales by default; methods that
choose among samples end at {most} of them); the chosen one has the best p2, of equal ones it is the smallest. Being
the best of several on these episodes, its p2 here is too high: final figures come from other episodes.

{units}"""


def markdown(table: "pd.DataFrame") -> str:
    """The tables for people, an arm after the other."""
    from benchmark.arm import setting_text

    units = "\n".join(f"- `{name}`: λ is {method.scale}." for name, method in METHODS.items() if name != "direct")
    parts = [TEXT.format(most=MOST_SAMPLES, units=units)]
    for arm, group in table.groupby(CHOSEN_FOR, sort=True):
        about = dict(zip(CHOSEN_FOR, arm, strict=True))
        parts += [
            f"## {about['robot']}, {setting_text(about)}",
            f"Base {about['base']} m, wrist {about['branch']}, {about['sampler']}-{about['sampling_steps']}, "
            f"{group.checkpoints.max()} checkpoints. Chosen:",
            shown(group[group.chosen]).to_markdown(index=False, disable_numparse=True),
            "All:",
            shown(group).to_markdown(index=False, disable_numparse=True),
        ]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    run_command(main, ScalesConfig, "scales")
