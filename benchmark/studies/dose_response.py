"""Does similarity predict transfer? What is known of arms beforehand, against what direct transfer does on them.

python -m benchmark.studies.dose_response step=predict
git add results/dose_response/predictors.csv && git commit
python -m benchmark.studies.dose_response step=play
python -m benchmark.studies.dose_response step=play last=true
python -m benchmark.studies.dose_response step=analyse
"""

import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.scenes import VALIDATION, check_scenes
from benchmark.settings.setting import SettingError, check_choice, check_counts, check_setting
from richmap.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.studies.dose_response_arms import StudyArm
    from envs.arm.placed_arm import PlacedArm

STEPS = ("predict", "play", "analyse")


@dataclass
class DoseResponseConfig:
    """Predicts success on many arms, plays there, and compares. Predictors are committed before the last third of arms
    is played; every step goes on where it was."""

    step: str = "predict"
    """predict (predictors.csv), play (direct transfer on the first two thirds of arms), or analyse (the page)."""
    last: bool = False
    """With step=play: the last third instead, drawn by split_seed; predictors.csv has to be committed by then."""
    arms: list[str] = field(default_factory=list)
    """Arms of the study by name, as in arms=[ur3,panda]; empty for all."""
    split_seed: int = 27
    """Draws the last third of the arms that have a name, and of the family; a whole number >= 0."""
    demonstrations: int = 20
    """Episodes of the source's scripted oracle whose paths the arms are asked to follow; a whole number from 1 to
    1000."""
    similarity: bool = True
    """Whether maps are built for MMD and energy, true or false."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of the policies."""
    episodes: int = 200
    """Validation scenes that each policy plays on each arm; a whole number >= 1."""
    output_dir: str = "results/dose_response"
    """Folder of predictors.csv, and of README.md, arms.csv and dose_response.png, which step=analyse makes."""
    rows: str = "results/dose_response"
    """Folder of the episodes."""
    workers: int = 2
    """Processes that sample and play; a whole number >= 1."""
    map: MapConfig = field(default_factory=lambda: MapConfig(cell_size=0.1, theta=0.2, stop_rate=0.05))
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_choice("step", self.step, STEPS)
        check_setting(self.split_seed >= 0, "split_seed", self.split_seed, "a whole number >= 0")
        known = 1 <= self.demonstrations <= 1000
        check_setting(known, "demonstrations", self.demonstrations, "a whole number from 1 to 1000")
        check_counts(self, "episodes", "workers")
        check_scenes(VALIDATION.start, self.episodes)
        check_folder(self.output_dir)
        check_folder(self.rows)

    @property
    def predictors(self) -> Path:
        """File of what is known beforehand."""
        return Path(self.output_dir) / "predictors.csv"


def main(config: DoseResponseConfig) -> None:
    """Take a step of the study."""
    from richmap.progress import plain_console

    {"predict": predict, "play": play, "analyse": analyse}[config.step](config, plain_console())


def chosen(config: DoseResponseConfig, console: "Console") -> "dict[str, tuple[StudyArm, PlacedArm]]":
    """The arms that were chosen and can hold the tool at the start, by name."""
    import platformdirs

    from benchmark.studies.dose_response_arms import able, study_arms

    arms = study_arms(Path(platformdirs.user_cache_dir("richmap"), "dose_response"))
    names = [arm.name for arm in arms]
    for name in config.arms:
        check_choice("arms", name, names)
    return able([arm for arm in arms if not config.arms or arm.name in config.arms], console)


def predict(config: DoseResponseConfig, console: "Console") -> None:
    """Write the predictors of the arms of which they are missing."""
    import pandas as pd

    from benchmark.rollouts.arm_oracle import demonstrated_paths
    from benchmark.studies.dose_response_arms import held_out
    from benchmark.studies.dose_response_predictors import predictors
    from envs.block_push.task import BLOCK_PUSH

    rows = {row["name"]: row for row in _known(config).to_dict("records")}
    arms = chosen(config, console)
    keys = {name: _key(config, arm) for name, (_, arm) in arms.items()}
    missing = [name for name in arms if any(rows.get(name, {}).get(k) != value for k, value in keys[name].items())]
    paths = demonstrated_paths(BLOCK_PUSH, config.demonstrations, console) if missing else []
    for name in missing:
        study, arm = arms[name]
        of_maps = (config.map, config.energy) if config.similarity else None
        found = predictors(arm, paths, of_maps, config.workers, console)
        rows[name] = {"name": name, "family": study.family, **keys[name], **found}
        console.print(rows[name])
        table = pd.DataFrame([*rows.values()])
        table["last"] = held_out(table.name.tolist(), table.family.tolist(), config.split_seed)
        with replacing(config.predictors) as file:
            table.to_csv(file, index=False)
    console.print(f"{len(rows)} arms: {config.predictors}. Commit it before step=play last=true.", soft_wrap=True)


def play(config: DoseResponseConfig, console: "Console") -> None:
    """Play what is missing of the first two thirds of arms, or of the last."""
    from benchmark.artifacts.known_policies import chosen_checkpoint
    from benchmark.rollouts.make_rollout import make_rollout
    from benchmark.rollouts.missing_episodes import play_missing

    known = _known(config)
    if known.empty:
        raise SettingError(f"There is no {config.predictors}. Take step=predict first.")
    if config.last and not is_committed(config.predictors):
        raise SettingError(f"{config.predictors} is not committed as it is. Commit it before the last third is played.")
    wanted = {*known.name[known["last"] == config.last]}
    arms = [study for name, (study, _) in chosen(config, console).items() if name in wanted]
    runs = [study.run(seed) for study in arms for seed in config.seeds]
    players = [make_rollout(run, 0.0, chosen_checkpoint(run), console) for run in runs]
    if not players:
        raise SettingError(f"None of these arms is in the {'last third' if config.last else 'first two thirds'}.")
    seeds = range(VALIDATION.start, VALIDATION.start + config.episodes)
    play_missing(players, seeds, lambda _: Path(config.rows), config.workers, "Dose and response", console)


def analyse(config: DoseResponseConfig, console: "Console") -> None:
    """Write the page and its figure, of the arms that were played."""
    from benchmark.studies.dose_response_analysis import figure, page

    table = with_success(config, console)
    folder = Path(config.output_dir)
    with replacing(folder / "dose_response.png") as file:
        figure(table).savefig(file, format="png", dpi=110, bbox_inches="tight")
    with replacing(folder / "README.md") as file:
        file.write_text(page(table))
    with replacing(folder / "arms.csv") as file:
        table.to_csv(file, index=False)
    console.print(f"{len(table)} arms: {folder / 'README.md'}", soft_wrap=True)


def with_success(config: DoseResponseConfig, console: "Console") -> "pd.DataFrame":
    """The predictors of each arm that was played, with its share of successes and how many episodes that is of.

    Raises:
        SettingError: If none was.
    """
    from benchmark.episodes.arm import of_arm
    from benchmark.episodes.table import read_episodes
    from envs.block_push.task import BLOCK_PUSH

    rows, known = read_episodes(Path(config.rows)), _known(config)
    success = {}
    for name, (_, arm) in chosen(config, console).items():
        played = of_arm(rows, arm)
        if len(played):
            success[name] = float(played[BLOCK_PUSH.success].mean()), len(played)
    if not success:
        raise SettingError(f"{config.rows} holds no episodes of these arms. Take step=play first.")
    table = known[known.name.isin([*success])].copy()
    table["success"], table["n"] = zip(*(success[name] for name in table.name), strict=True)
    return table


def is_committed(file: Path) -> bool:
    """Whether git has a file as it is."""

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", *arguments, "--", file.name], cwd=file.parent, capture_output=True, text=True, check=True
        ).stdout

    try:
        return bool(git("log", "-1", "--format=%H")) and not git("status", "--porcelain")
    except (OSError, subprocess.CalledProcessError):
        return False


def _known(config: DoseResponseConfig) -> "pd.DataFrame":
    import pandas as pd

    file = config.predictors
    return pd.read_csv(file) if file.exists() else pd.DataFrame({"name": [], "last": []})


def _key(config: DoseResponseConfig, arm: "PlacedArm") -> dict[str, str | int]:
    """What an arm's predictors are of."""
    from benchmark.episodes.arm import arm_columns

    told = arm_columns(arm)
    placed = " ".join(f"{key}={told[key]}" for key in ("base_x", "base_y", "base_z", "narrowed", "tool_length"))
    return {"robot_fingerprint": arm.robot_fingerprint, "placed": placed, "demonstrations": config.demonstrations}


if __name__ == "__main__":
    run_command(main, DoseResponseConfig, "studies.dose_response", goes_on=True)
