"""The file that holds a task's chosen scales, one of each method."""

from pathlib import Path
from typing import Any

import yaml

from benchmark.settings.setting import SettingError


def scales_file(folder: str, task: str) -> Path:
    """The file of a task's chosen scales, by the task's name."""
    return Path(folder) / f"{task}.yaml"


def read_scales(file: Path) -> dict[str, dict[str, Any]]:
    """What was chosen for each method, and from what; nothing if the file is not there.

    Raises:
        SettingError: If it is damaged.
    """
    try:
        said = yaml.safe_load(file.read_text()) if file.exists() else None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SettingError(f"{file} is damaged ({error}). Choose the scales anew: benchmark.choose_scales.") from error
    said = {} if said is None else said
    if not isinstance(said, dict) or not all(_is_chosen(each) for each in said.values()):
        raise SettingError(f"{file} is damaged: it has no scale of each method. Choose anew: benchmark.choose_scales.")
    return said


def _is_chosen(said: object) -> bool:
    return isinstance(said, dict) and isinstance(said.get("scale"), int | float)
