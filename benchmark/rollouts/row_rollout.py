"""Row rollout."""

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.artifacts.checkpoint import GUIDED, Checkpoint
from benchmark.artifacts.fields import MAPS
from benchmark.artifacts.known_policies import CHECKPOINTS, of_task, published
from benchmark.episodes.arm import choices_of, chosen_arm
from benchmark.episodes.episode import row_name
from benchmark.rollouts.field_settings import noted_settings
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.settings.config import CLASS_IN_FILE, LimitsConfig, RunConfig
from benchmark.settings.limits import MOST_ENVIRONMENTS
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.robot_config import ArmConfig, RobotConfig
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.task import chosen_task
from policies.method import AT_ONE_HEIGHT
from policies.methods import METHODS

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.rollouts.entry import Entry
    from benchmark.rollouts.rollout import Rollout
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task


def row_rollout(row: Mapping[str, Any], config: ReplayConfig, console: "Console") -> "Rollout":
    """What a row was rolled out with, from the pieces that are on this machine.

    Raises:
        SettingError: If it is of another episode version, or a piece is missing.
    """
    import torch

    task = chosen_task(config.task)
    check_version(row, task)
    if row["device"] == "cuda" and not torch.cuda.is_available():
        raise SettingError(f"{row_name(row)} ran on a GPU, and PyTorch finds none here. Replay it where it ran.")
    entry = row_entry(row, config.entry)
    checkpoint = row_checkpoint(row, config.policy, entry, config.task)
    if noted := noted_settings(Path(config.table), row["field_fingerprint"]):
        config = replace(config, map=noted[0], energy=noted[1])
    run = row_settings(row, config, Checkpoint(checkpoint).type == GUIDED)
    if entry is None:
        rollout = make_rollout(run, row["lambda"], checkpoint, console)
    else:
        rollout = entry.at(row["lambda"]).rollout(run, task, chosen_arm(run, task), checkpoint, console)
    check_arm(row, rollout.arm)
    made, stored = rollout.condition.field_fingerprint, row["field_fingerprint"]
    if made != stored:
        raise SettingError(
            f"{row_name(row)} was guided by the field {stored[:16] or 'none'}, and these settings make "
            f"{made[:16] or 'none'}. Give the map.* and energy.* that it was made with."
        )
    return rollout


def check_version(row: Mapping[str, Any], task: "Task") -> None:
    """Refuse a row of another episode version: what is played here is another episode.

    Raises:
        SettingError: If it is; it says which commit plays the row.
    """
    try:
        task.check_version(row["setting"], row["episode_version"])
    except ValueError as error:
        raise SettingError(f"{row_name(row)}: {error}") from error


def check_arm(row: Mapping[str, Any], arm: "PlacedArm") -> None:
    """Refuse a row of an arm that is described otherwise.

    Raises:
        SettingError: If it is.
    """
    if arm.robot_fingerprint != row["robot_fingerprint"]:
        raise SettingError(
            f"{row_name(row)} is of an arm with the fingerprint {row['robot_fingerprint'][:16]}, and here it "
            f"has {arm.robot_fingerprint[:16]}. Give its files and robot.* as they were."
        )


def row_entry(row: Mapping[str, Any], folder: str) -> "Entry | None":
    """The entry that a row is of; None for one of our own methods.

    Raises:
        SettingError: If it is not the one in the folder, or the method is neither an entry's nor ours.
    """
    from benchmark.rollouts.entry import Entry

    if not row["entry_hash"]:
        if row["method"] not in METHODS:
            raise SettingError(f"{row_name(row)}: there is no method {row['method']!r}. Methods: {', '.join(METHODS)}.")
        return None
    if not folder:
        raise SettingError(
            f"{row_name(row)} is of an entry. Give its folder: entry=<folder>; or a class of a file: "
            "entry=<file.py>:<Class>."
        )
    is_class = re.fullmatch(CLASS_IN_FILE, folder)
    entry = Entry.of_class(folder, LimitsConfig()) if is_class else Entry.load(Path(folder))
    if entry.files_hash != row["entry_hash"]:
        raise SettingError(
            f"{row_name(row)} is of an entry whose files have the hash {row['entry_hash'][:16]}, and those in "
            f"{folder} have {entry.files_hash[:16]}. Give the folder as it was."
        )
    return entry


def row_checkpoint(row: Mapping[str, Any], policy: str, entry: "Entry | None", task: str) -> Path:
    """Folder of a row's policy: in the folder that is named, in the entry, or among ours.

    Raises:
        SettingError: If its weights are not there.
    """
    if policy:
        folders = [Checkpoint.from_path(policy).folder]
    elif entry is not None and entry.about.policy:
        folders = entry.checkpoints([], task)
    else:
        roots = [of_task(root, task) for root in CHECKPOINTS]
        folders = [file.parent for root in roots for file in sorted(root.glob("*/model.safetensors"))]
        folders.sort(key=lambda folder: folder.name != row["checkpoint"])
    for folder in folders:
        if policy_hash(folder) == row["checkpoint_hash"]:
            return folder
    raise SettingError(
        f"{row_name(row)}: no policy with the weights {row['checkpoint_hash'][:16]} is in "
        f"{', '.join(map(str, folders)) or 'the known folders'}. Give its folder: policy=<folder>"
        + (", or train it again: see docs/reproduce.md." if row["checkpoint_hash"] in published(task).values() else ".")
    )


@lru_cache
def policy_hash(folder: Path) -> str:
    """That of the checkpoint in a folder, read once."""
    return Checkpoint(folder).policy_hash


def row_robot(row: Mapping[str, Any], given: RobotConfig) -> RobotConfig:
    """A row's arm: one that ships, or the given custom one.

    Raises:
        SettingError: If it is neither.
    """
    from richmap.robots import ROBOTS

    if row["robot"] in ROBOTS:
        return RobotConfig(row["robot"])
    if given.name != "custom":
        raise SettingError(
            f"{row_name(row)} is of {row['robot']}, an arm that does not ship. Give what it was run with: "
            "robot=custom robot.path=robot.urdf robot.base=<link> robot.end_effector=<link>."
        )
    return given


def row_settings(row: Mapping[str, Any], config: ReplayConfig, guided: bool) -> RunConfig:
    """The settings of `benchmark.run` that make a row's condition.

    Args:
        row: The row.
        config: Settings of the field, but for the size of its cells.
        guided: Whether the policy is of our type, whose sampler is set.

    Raises:
        SettingError: If the row says what no rollout has.
    """
    batch = row["batch_size"]
    check_setting(1 <= batch <= MOST_ENVIRONMENTS, "batch_size", batch, f"1 to {MOST_ENVIRONMENTS}")
    seed = row.get("episode_seed", 0)
    check_setting(seed >= 0, "episode_seed", seed, "a whole number >= 0")
    kind = METHODS[row["method"]].field if row["method"] in METHODS else None
    of_map_s_cells = kind in MAPS and kind not in AT_ONE_HEIGHT  # Those have cells of their own.
    arm = ArmConfig(**choices_of(row))
    ours = {}
    if row["method"] in METHODS:
        ours = {"method": row["method"], "guidance_scale": row["lambda"]}
    sampler = {"sampler": row["sampler"], "sampling_steps": row["sampling_steps"]} if guided else {}
    return RunConfig(
        task=config.task,
        robot=row_robot(row, config.robot),
        setting=row["setting"],
        arm=arm,
        batch_size=row["batch_size"],
        device=row["device"],
        workers=config.workers,
        map=replace(config.map, cell_size=row["cell_size"]) if of_map_s_cells else config.map,
        energy=config.energy,
        **ours,
        **sampler,
    )
