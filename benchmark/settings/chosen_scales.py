"""The file that holds a task's chosen scales, one of each method."""

from pathlib import Path
from typing import Any

from benchmark.settings.limits import MOST_LAMBDA
from benchmark.settings.setting import SettingError
from richmap.given_files import given_yaml

MOST_BYTES = 100_000
"""Of a file of chosen scales: 20 times what one of all our methods takes."""


USUAL_FOLDER = "results/scales"
"""Of those that ship."""


def chosen_scales(folder: str, task: str) -> dict[str, dict[str, Any]]:
    """A task's chosen scales (`read_scales`): of the usual folder those that ship, where it has none of the task below
    the folder that a command is typed in.

    Raises:
        SettingError: If they are damaged.
    """
    file = scales_file(folder, task)
    if folder == USUAL_FOLDER and not file.exists():
        file = Path(__file__).parents[2] / file
    return read_scales(file)


def scales_file(folder: str, task: str) -> Path:
    """The file of a task's chosen scales, by the task's name."""
    return Path(folder) / f"{task}.yaml"


def read_scales(file: Path) -> dict[str, dict[str, Any]]:
    """What was chosen for each method, and from what; nothing if the file is not there.

    Raises:
        SettingError: If it is damaged.
    """
    try:
        said = given_yaml(file, MOST_BYTES) if file.exists() else None
    except ValueError as error:
        raise SettingError(f"{file} is damaged ({error}). Choose the scales anew: benchmark.choose_scales.") from error
    said = {} if said is None else said
    if not isinstance(said, dict) or not all(isinstance(name, str) and _is_chosen(each) for name, each in said.items()):
        raise SettingError(f"{file} is damaged: it has no scale of each method. Choose anew: benchmark.choose_scales.")
    return said


def _is_chosen(said: object) -> bool:
    scale = said.get("scale") if isinstance(said, dict) else None
    return isinstance(scale, int | float) and not isinstance(scale, bool) and 0 <= scale <= MOST_LAMBDA
