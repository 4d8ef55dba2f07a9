"""Files of settings in a folder that is given by --config-dir: read as data, before Hydra composes and instantiates."""

import re
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from benchmark.settings.setting import SettingError
from richmap.given_files import given_yaml

ALLOWED = {"mode", "sweep", "run", "sweeper", "launcher", "job", "output_subdir", "verbose"}
"""What a file may say of Hydra itself: nothing else of it is needed, and much of it names code to run."""
NAMES_CODE = ("_target_", "()", "class")
MOST_FILES, MOST_BYTES = 1000, 100_000


def check_given(flags: Sequence[str], overrides: Sequence[str], groups: Sequence[str], name: str) -> None:
    """Look through the files that a command of this name takes from the folders of --config-dir and --config-path, and
    those that their defaults name.

    Raises:
        SettingError: If a file is no YAML, asks for code to be run, or its defaults name each other in a circle.
    """
    given = [(flag, Path(value)) for flag, value in zip(flags, flags[1:], strict=False)]
    if any(override.lstrip("+").startswith("hydra.searchpath") for override in overrides):
        raise SettingError("hydra.searchpath is not allowed. Allowed: a folder of files of your own by --config-dir.")
    primary = [str(value) for flag, value in given if flag in ("--config-name", "-cn")] or [name]
    for folder in (value for flag, value in given if flag in ("--config-dir", "-cd", "--config-path", "-cp")):
        chosen = [folder / f"{each.removesuffix('.yaml')}.yaml" for each in primary]
        for override in overrides:
            group, _, values = override.lstrip("+").partition("=")
            group = group.partition("@")[0]
            if group not in groups and not group.startswith("hydra/"):
                continue
            if re.fullmatch(r"[\w/.,-]+", values):
                chosen += [folder / group / f"{name}.yaml" for name in values.split(",")]
            else:  # A glob(), of which any file may be taken.
                chosen += islice(sorted((folder / group).glob("*.yaml")), MOST_FILES)
        for file in chosen:
            if file.exists():
                _check_file(file, folder, [])


def _check_file(file: Path, folder: Path, above: list[Path]) -> None:
    if file in above:
        raise SettingError(f"{file} names itself in its defaults, by way of {above[-1].name}.")
    try:
        said = given_yaml(file, MOST_BYTES)
    except (ValueError, OSError) as error:
        raise SettingError(f"{file} is no file of settings ({error!s:.300}).") from error
    if not isinstance(said, dict):
        raise SettingError(f"{file} holds no settings. Write setting: value, a line each.")
    of_hydra = said.get("hydra") or {}
    others = {*of_hydra} - ALLOWED if isinstance(of_hydra, dict) else {str(of_hydra)[:50]}
    code = [key for key in _keys(said) if key in NAMES_CODE]
    if others or code:
        named = f"hydra.{min(map(str, others))}" if others else code[0]
        raise SettingError(f"{file} sets {named:.100}, by which code is run. Files of settings hold values alone.")
    defaults = said.get("defaults")
    for entry in defaults if isinstance(defaults, list) else []:
        for name in _named(entry):
            for root in {folder} if name.startswith("/") else {folder, file.parent}:
                if (named_file := root / f"{name.lstrip('/')}.yaml").exists():
                    _check_file(named_file, folder, [*above, file])


def _named(entry: Any) -> list[str]:
    """What an entry of a list of defaults names: files without their ending."""
    if isinstance(entry, dict):
        groups = {
            str(group).split()[-1].partition("@")[0] if str(group).strip() else "": names
            for group, names in entry.items()
        }
        return [
            f"{group}/{name}"
            for group, names in groups.items()
            for name in (names if isinstance(names, list) else [names])
            if group and isinstance(name, str)
        ]
    name = str(entry).removesuffix(".yaml")
    return [name] if isinstance(entry, str) and name not in ("", "_self_") else []


def _keys(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        yield from map(str, value)
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _keys(each)
