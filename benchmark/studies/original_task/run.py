"""The paper's transfer table in the original task: policies, rollouts, and the table beside the paper's.

python -m benchmark.studies.original_task.run assets=/path/to/diffusion_policy stage=first
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import SOURCE, RobotConfig
from benchmark.settings.setting import SettingError, check_choice, check_counts, check_setting
from benchmark.studies.original_task.rule import FIRST_LAMBDAS, FIRST_X, LAMBDAS, PAPER

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.rollout import Rollout

STAGES = ("policies", "source", "first", "second", "table")
FIRST_SEED, SCENES = 100_000, 50
"""The paper's scenes."""


@dataclass
class OriginalTaskConfig:
    """Rolls policies out in the original block-push task, PyBullet's, with every arm's base moved to the table."""

    assets: str = "diffusion_policy"
    """Checkout of real-stanford/diffusion_policy, whose blocks and tool are used."""
    stage: str = "first"
    """policies (1,000 undisturbed demonstrations on the original's xArm6, nine policies), source (these on the xArm6),
    first (three policies, bases and three lambdas), second (nine policies, eleven lambdas, at the base that the rule
    takes), table (what is stored)."""
    recipe: str = "clean"
    """Whose policies: clean (nine, of the stage policies) or robust (the three that ship)."""
    response: str = "own"
    """Which arm's effector policies are shown: own, where the arm's is measured; or xarm6, where the xArm6's would be
    behind the same command, by its demonstrations (stage=policies)."""
    arms: list[str] = field(default_factory=lambda: list(PAPER))
    """Arms that are rolled out, in this order."""
    bases: list[float] = field(default_factory=lambda: list(FIRST_X))
    """Bases of the first stage: how much nearer to the table they are, in m."""
    lambdas: list[float] = field(default_factory=lambda: list(FIRST_LAMBDAS))
    """Scales of the method paper in the first stage, in 1/m; 0 is direct transfer."""
    scenes: int = SCENES
    """How many of the paper's 50 scenes; a whole number from 1 to 50."""
    device: str = "cpu"
    """Where policies are trained: cpu or cuda. They are rolled out on the CPU."""
    threads: int = 1
    """CPU threads of each training; a whole number >= 1."""
    output_dir: str = "outputs/original_task"
    """Folder of demonstrations, policies, fields and rows."""
    workers: int = 2
    """Processes that simulate or train; a whole number >= 1."""

    def __post_init__(self) -> None:
        check_choice("stage", self.stage, STAGES)
        check_choice("recipe", self.recipe, ("clean", "robust"))
        check_setting(self.response in ("own", SOURCE), "response", self.response, f"own, {SOURCE}")
        check_setting({*self.arms} <= {*PAPER}, "arms", self.arms, ", ".join(PAPER))
        check_setting(all(0 <= x <= 0.2 for x in self.bases), "bases", self.bases, "numbers from 0 to 0.2 m")
        check_setting({*self.lambdas} <= {*LAMBDAS}, "lambdas", self.lambdas, ", ".join(f"{x:g}" for x in LAMBDAS))
        check_setting(1 <= self.scenes <= SCENES, "scenes", self.scenes, f"a whole number from 1 to {SCENES}")
        check_choice("device", self.device, ("cpu", "cuda"))
        check_counts(self, "threads", "workers")
        check_folder(self.output_dir)

    @property
    def folder(self) -> Path:
        """Where demonstrations, policies, fields and rows go."""
        return Path(self.output_dir)

    @property
    def rows(self) -> Path:
        """Folder of this recipe's table of episodes, with this response shown."""
        return self.folder / (self.recipe if self.response == "own" else f"{self.recipe}_{self.response}_response")


def main(config: OriginalTaskConfig) -> None:
    """Do the stage, and what it needs; what is stored already is not done again."""
    from benchmark.studies.original_task.rule import in_words
    from benchmark.studies.original_task.task import VERSION
    from richmap.progress import plain_console

    console = plain_console()
    if config.stage == "policies":
        train_policies(config)
    elif config.stage != "table":
        rollouts = {"source": source, "first": first, "second": second}[config.stage](config, console)
        run(rollouts, config, console)
    if config.stage != "policies":
        own = None if config.response == "own" else stored(replace(config, response="own"))
        rows = stored(config)
        console.print(text(rows, own), soft_wrap=True, highlight=False, markup=False)
        if len(rows):
            console.print(in_words(rows[rows.episode_version == VERSION]), soft_wrap=True, highlight=False)


def train_policies(config: OriginalTaskConfig) -> None:
    """Demonstrations in PyBullet, then nine policies."""
    from benchmark.studies.original_task.demonstrations import collect, trainings
    from benchmark.training.side_by_side import train_all

    require_bullet(config)
    collect(config.assets, config.folder, config.workers)
    train_all(trainings(config.folder, config.device, config.threads), config.workers)


def policies(config: OriginalTaskConfig, last: bool) -> list[Path]:
    """Folders of the recipe's policies, or of one for each training seed; of the robust ones no more ship.

    Raises:
        SettingError: If they are not there.
    """
    from benchmark.artifacts.known_policies import checkpoint_folder
    from benchmark.studies.original_task.demonstrations import SEEDS, STEPS

    if config.recipe == "robust":
        return [checkpoint_folder(seed, 1) for seed in SEEDS]
    steps = STEPS[-1:] if last else STEPS
    folders = [config.folder / "policies" / f"seed{seed}-step{step}" for seed in SEEDS for step in steps]
    if lacking := [folder for folder in folders if not folder.is_dir()]:
        raise SettingError(f"output_dir: there is no policy {lacking[0]}. Train them first: stage=policies.")
    return folders


def source(config: OriginalTaskConfig, console: "Console") -> "list[Rollout]":
    """All nine policies on the original's xArm6."""
    return rollouts_of(config, ["xarm6"], [0.0], [0.0], policies(config, last=False), console)


def first(config: OriginalTaskConfig, console: "Console") -> "list[Rollout]":
    """The last policy of each training seed on the arms, at every base and with every lambda."""
    return rollouts_of(config, config.arms, config.bases, config.lambdas, policies(config, last=True), console)


def second(config: OriginalTaskConfig, console: "Console") -> "list[Rollout]":
    """All nine at the base that the rule takes from the first stage, with all lambdas.

    Raises:
        SettingError: If the first stage is not complete.
    """
    from benchmark.studies.original_task.rule import chosen_x

    rows = of_first_stage(stored(config), policies(config, last=True))
    wanted = len(PAPER) * len(FIRST_X) * len(FIRST_LAMBDAS) * 3 * SCENES
    if len(rows) < wanted:
        raise SettingError(
            f"stage=second goes on from stage=first, of which {len(rows)} of {wanted} episodes are there. Finish it."
        )
    x = chosen_x(rows)
    console.print(f"Base by the rule: x = {x:g} m")
    return rollouts_of(config, config.arms, [x], list(LAMBDAS), policies(config, last=False), console)


def of_first_stage(rows: "pd.DataFrame", checkpoints: Sequence[Path]) -> "pd.DataFrame":
    """Those rows of the table that the first stage asks for, of the version that episodes have now."""
    from benchmark.artifacts.checkpoint import Checkpoint
    from benchmark.studies.original_task.task import VERSION

    hashes = [Checkpoint(folder).policy_hash for folder in checkpoints]
    asked = rows.robot.isin(PAPER) & rows["lambda"].isin(FIRST_LAMBDAS) & rows.base_x.isin(FIRST_X)
    return rows[asked & rows.checkpoint_hash.isin(hashes) & (rows.episode_version == VERSION)]


def rollouts_of(
    config: OriginalTaskConfig,
    arms: Sequence[str],
    bases: Sequence[float],
    lambdas: Sequence[float],
    checkpoints: Sequence[Path],
    console: "Console",
) -> "list[Rollout]":
    """One for each arm, base, lambda and policy; an arm's at one base follow each other, as they share a simulation."""
    from benchmark.rollouts.make_condition import make_condition
    from benchmark.rollouts.rollout import Rollout
    from benchmark.studies.original_task.response import Response
    from benchmark.studies.original_task.task import NAME, OF_SOURCE, VERSION, original_arm, original_task
    from richmap.similarity.load_field import load_field

    own, response = config.response == "own", None
    if not own:
        demonstrations = config.folder / "demonstrations"
        if not (demonstrations / "data").is_dir():
            raise SettingError(f"response={SOURCE} is fitted to {demonstrations}, which is not there: stage=policies.")
        response, left = Response.of_demonstrations(demonstrations)
        console.print(f"{response.text} What the fit leaves: {1000 * left:.2f} mm (root mean square).", soft_wrap=True)
    task = original_task(str(Path(config.assets).resolve()), response)
    rollouts = []
    for robot in arms:
        run = RunConfig(robot=RobotConfig(robot), setting="original", device="cpu")
        for x in bases:
            arm = original_arm(robot, x)
            file = moved_field(config, robot, x, console) if any(lambdas) else None
            for scale in lambdas:
                method, used = ("paper", file) if scale else ("direct", None)
                field = None if used is None else load_field(used)
                for checkpoint in checkpoints:
                    condition = make_condition(run, task, arm, method, scale, checkpoint, field)
                    condition = replace(condition, task=NAME if own else OF_SOURCE, episode_version=VERSION)
                    rollouts.append(Rollout(task, arm, condition, checkpoint, used, kind="energy" if used else None))
    return rollouts


def moved_field(config: OriginalTaskConfig, robot: str, x: float, console: "Console") -> Path:
    """File of an arm's field of energy at the common base, moved with the base: both arms stand nearer to the table."""
    from benchmark.artifacts.maps import energy_field
    from richmap.robots.robots import load_robot
    from richmap.similarity.energy import EnergyField

    file = config.folder / "fields" / f"{robot}-{round(1000 * x):03d}mm.safetensors"
    if not file.exists():
        common, _ = energy_field(
            load_robot(robot), (0.0, 0.0, 0.0), MapConfig(), EnergyConfig(), config.workers, console
        )
        about = {**common.about, "fingerprint": f"{common.about['fingerprint']} moved by {x:g} m"}
        EnergyField(common.grid.moved(np.array([-x, 0.0, 0.0])), common.values, about).save(file)
    return file


def run(rollouts: "Sequence[Rollout]", config: OriginalTaskConfig, console: "Console") -> None:
    """Rolls out what is not stored yet, batch by batch."""
    from benchmark.rollouts.missing_episodes import play_missing

    require_bullet(config)
    play_missing(
        rollouts,
        range(FIRST_SEED, FIRST_SEED + config.scenes),
        lambda _: config.rows,
        config.workers,
        f"The original task, stage {config.stage}, {config.recipe} policies, {config.response} response",
        console,
    )


def require_bullet(config: OriginalTaskConfig) -> None:
    """Refuse to begin without PyBullet or the original's assets.

    Raises:
        SettingError: If one is not there.
    """
    from importlib.util import find_spec

    from benchmark.studies.original_task.simulation import ASSETS

    if find_spec("pybullet") is None:
        raise SettingError("This study needs PyBullet: uv pip install pybullet-arm64==3.2.8 (docs/original_task.md).")
    if not (Path(config.assets) / ASSETS / "block.urdf").is_file():
        raise SettingError(
            f"assets={config.assets} is no checkout of real-stanford/diffusion_policy: it lacks {ASSETS}."
        )


def stored(config: OriginalTaskConfig) -> "pd.DataFrame":
    """The recipe's rows."""
    from benchmark.episodes.table import read_episodes

    return read_episodes(config.rows)


def text(rows: "pd.DataFrame", own: "pd.DataFrame | None" = None) -> str:
    """Scores, p1 and p2 in percent by the episodes' version, arm, base and lambda, beside the paper's figures; what
    guidance gains in score, in points, with its interval for other trainings and other episodes, and likewise what is
    gained over rows of policies that are shown the arm's own effector, if there are some."""
    if rows.empty:
        return "There are no rows yet."
    of_base = ["episode_version", "robot", "base_x"]
    groups = rows.groupby([*of_base, "lambda"])
    table = 100 * groups[["score", "p1", "p2"]].mean()
    table["tilt, at most [deg]"] = groups.tilt_max.max() * 57.29578
    table["policies"], table["episodes"] = groups.checkpoint_hash.nunique(), groups.size()
    guided, direct = rows[rows["lambda"] > 0], rows[rows["lambda"] == 0]
    table["minus direct"] = _gains(guided, direct, of_base, table.index)
    if own is not None and len(own):
        table["minus own effector"] = _gains(rows, own, [*of_base, "lambda"], table.index)
    for arm, (direct, guided) in PAPER.items():
        for key in table.index:
            if key[1] == arm:
                table.loc[key, "the paper"] = guided if key[3] else direct
    return table.round(1).reset_index().to_markdown(index=False)


def _gains(rows: "pd.DataFrame", others: "pd.DataFrame", alike: list[str], index: "pd.Index") -> list[str]:
    """What rows score more than others of the same policy, scene and these columns, by the index of a table."""
    from benchmark.scoring.statistics import Crossed, clustered_difference

    pairs = rows.merge(others, on=[*alike, "checkpoint_hash", "episode_seed"], suffixes=("", "_other"))
    gains = dict.fromkeys(index, "")
    for key, each in pairs.assign(scale=pairs["lambda"]).groupby(["episode_version", "robot", "base_x", "scale"]):
        gain = clustered_difference(Crossed.of(each, each.score - each.score_other))
        gains[key] = "{:+.1f} [{:+.1f}, {:+.1f}]".format(*(100 * x for x in gain))
    return [*gains.values()]


if __name__ == "__main__":
    run_command(main, OriginalTaskConfig, "original_task", goes_on=True)
