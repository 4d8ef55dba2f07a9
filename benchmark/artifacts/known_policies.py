"""The policies that are there: those that ship, those that were trained here, or the one that settings name."""

import fnmatch
import json
import re
from pathlib import Path

from benchmark.artifacts.checkpoint import GUIDED, Checkpoint
from benchmark.settings.config import RunConfig
from benchmark.settings.recipe import RECIPES, USUAL, policy_name
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task

RESULTS = Path(__file__).parents[2] / "results"
"""What is published."""

CHECKPOINTS = [
    RESULTS / "checkpoints",
    *(Path("outputs") / "source_policies" / recipe for recipe in RECIPES),
    Path("outputs") / "checkpoints",
]
"""Where checkpoints are looked for: those that ship, and those that `benchmark.source_policies` and `benchmark.train`
make; those of another task than block_push in a folder of its name."""


HUB_NAME = r"[\w.-]+/[\w.-]+"
"""What a policy on the Hub is called: its owner and its name."""

HUB_FILES = ["config.json", "model.safetensors", "train_config.json", "policy_*.json", "policy_*.safetensors"]
"""Of a checkpoint there."""


NONE_HERE = "none (those that ship lie in the project's own folder: use the commands of a clone)"


def of_task(folder: Path, task: str) -> Path:
    """Where a task's checkpoints lie in one of these folders."""
    return folder if task == RunConfig.task else folder / task


def chosen_checkpoint(config: RunConfig) -> Path:
    """Folder of the policy to roll out: the one named by its path, or else by its training seed.

    Raises:
        SettingError: If there is none, or it cannot be guided and should be.
    """
    if not config.policy:
        return checkpoint_folder(config.seed, config.checkpoint, config.recipe, config.task)
    checkpoint = Checkpoint.from_path(config.policy)
    if checkpoint.type != GUIDED and config.guidance_scale != 0:
        scale = "null" if config.guidance_scale is None else f"{config.guidance_scale:g}"
        raise SettingError(
            f"lambda={scale} needs a policy of type {GUIDED}, whose sampling can be guided. "
            f"{config.policy} is of type {checkpoint.type}: use lambda=0."
        )
    return checkpoint.folder


def policy_folder(name: str, task: str = RunConfig.task) -> Path:
    """Folder of a policy: a task's one of this name that ships or was trained here, the folder of that name, or else
    the copy of what the Hub has by it, fetched if it is not there yet.

    Raises:
        SettingError: If there is none.
    """
    folders = [of_task(root, task) / name for root in CHECKPOINTS]
    named = [folder for folder in folders if (folder / "model.safetensors").exists()]
    if named:
        return named[0]
    if not Path(name).exists() and not re.fullmatch(HUB_NAME, name):
        there = sorted({folder.name for root in CHECKPOINTS for folder in policies_in(of_task(root, task))})
        raise SettingError(
            f"policy={name} is no folder of a checkpoint, and no policy of {task} that is here: "
            f"{', '.join(there) or NONE_HERE}."
        )
    if Path(name).exists():
        return Checkpoint.from_path(name).folder
    return Checkpoint.from_path(str(_from_hub(name))).folder


def _from_hub(name: str) -> Path:
    """A checkpoint's files from the Hub, and no others."""
    from huggingface_hub import snapshot_download

    try:
        return Path(snapshot_download(name, allow_patterns=HUB_FILES))
    except Exception as error:  # Of the network, the Hub or its copies here.
        why = " ".join(str(error).split())[:300]
        raise SettingError(
            f"policy={name} is no folder here, and was not had from the Hub: {type(error).__name__}: {why}. "
            "Give the folder of a checkpoint, or look whether the Hub can be reached."
        ) from error


def checkpoint_folder(seed: int, rank: int = 1, recipe: str = USUAL, task: str = RunConfig.task) -> Path:
    """Folder of a task's checkpoint of this rank with this training seed, of this recipe.

    Raises:
        SettingError: If there is none.
    """
    name, roots = policy_name(recipe, seed, rank), [of_task(root, task) for root in CHECKPOINTS]
    for root in roots:
        folder = root / name
        if (folder / "model.safetensors").exists():
            return Checkpoint.from_path(str(folder)).folder
    there = {folder.name for root in roots for folder in policies_in(root, recipe)}
    why = ": its rows are published, but of each seed only the best policy ships" if name in published(task) else ""
    command = "" if task == RunConfig.task else f"task={task} "
    if not (there or chosen_task(task).demonstrator):
        raise SettingError(
            f"task={task} has no policy here, and nothing to learn one from. Name one: policy=path/to/checkpoint, or "
            "play without any: method=plain_oracle."
        )
    raise SettingError(
        f"{command}recipe={recipe} seed={seed} checkpoint={rank} is not there{why}. Here: "
        f"{', '.join(sorted(there)) or NONE_HERE}. Train it (hours): python -m benchmark.source_policies {command}"
        f"recipe={recipe} seeds=[{seed}], or name one of yours: policy=path/to/checkpoint."
    )


def policies_in(folder: Path, recipe: str = "") -> list[Path]:
    """Folders of a recipe's policies in a folder; of all policies unless one is named."""
    name = policy_name(recipe, "*", "*") if recipe else "*"
    return [file.parent for file in folder.glob(f"{name}/model.safetensors")]


def shipped(recipe: str = USUAL, task: str = RunConfig.task) -> set[str]:
    """Hashes of a recipe's policies whose rows are published, for a task, whether or not all of them lie here."""
    hashes = published(task)
    return {hashes[name] for name in fnmatch.filter(hashes, policy_name(recipe, "*", "*"))}


def published(task: str = RunConfig.task) -> dict[str, str]:
    """Names of the policies whose rows are published, for a task, with their hashes."""
    file = of_task(CHECKPOINTS[0], task) / "policies.json"
    return json.loads(file.read_text()) if file.exists() else {}
