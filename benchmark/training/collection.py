"""Collection."""

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from benchmark.artifacts.alone import alone
from benchmark.settings.paths import check_folder
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task
from benchmark.training.demonstration_recipe import CollectConfig
from richmap.outputs import writing


def collect(config: CollectConfig) -> Path:
    """Collects the demonstrations if they are not there yet, and gives their folder.

    A run that was killed goes on with the chunks of episodes that it had stored, of the same episode version.

    Raises:
        SettingError: If others are there, or another process collects them just now.
    """
    root, version = Path(config.folder), chosen_task(config.task).episode_version("embodied")
    if root.exists():
        _check_demonstrations(root, config, version)
        return root
    check_folder(str(root))
    with alone(root):
        if not root.exists():
            _collect(config, root, {"recipe": config.recipe, "episode_version": version})
    return root


def _collect(config: CollectConfig, root: Path, about: Mapping[str, object]) -> None:
    from benchmark.training.demonstration_chunks import simulate

    chunks = root.parent / f".{root.name}-{digest(about)}"
    chunks.mkdir(parents=True, exist_ok=True)
    simulate(config, chunks)
    _assemble(config, chunks, root, about)
    shutil.rmtree(chunks)


def digest(values: Mapping[str, object]) -> str:
    """Short name for settings: the same for equal ones, another for others."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:12]


def _check_demonstrations(root: Path, config: CollectConfig, version: int) -> None:
    """Refuse demonstrations that these settings or this episode version would not make."""
    file = root / "meta" / "collect.json"
    if not file.exists():
        raise SettingError(f"output_dir={root} is there and holds no demonstrations. Choose another folder.")
    asked = {**config.recipe, "episode_version": version}
    try:
        about = json.loads(file.read_text())
        made = {**about["recipe"], "episode_version": about.get("episode_version")}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SettingError(f"{file} is damaged ({error!r}). Delete {root} or choose another output_dir.") from error
    different = {key: made.get(key) for key, value in asked.items() if made.get(key) != value}
    if different:
        raise SettingError(
            f"{root} holds demonstrations made otherwise ({different}). Delete the folder or choose another output_dir."
        )


def _assemble(config: CollectConfig, chunks: Path, root: Path, about: Mapping[str, object]) -> None:
    """Writes the chunks as a LeRobotDataset, which appears under its name when it is complete."""
    from benchmark.training.dataset_card import dataset_card
    from benchmark.training.demonstration_chunks import played, stored
    from benchmark.training.demonstration_dataset import write_dataset

    partial = root.with_name(f".{root.name}.tmp")
    shutil.rmtree(partial, ignore_errors=True)
    with writing(root):
        write_dataset(stored(config, chunks), partial, chosen_task(config.task), config.count, config.image_size)
        about = {**about, "played": played(config, chunks)}
        (partial / "meta" / "collect.json").write_text(json.dumps(about, indent=2) + "\n")
        (partial / "README.md").write_text(dataset_card(partial, root.name, config))
        os.replace(partial, root)
