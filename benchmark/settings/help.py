"""What `--help` says: every setting of a command with the value that it has, and what it is."""

import inspect
import textwrap
from collections.abc import Callable
from itertools import pairwise, takewhile
from pathlib import Path

from hydra import compose
from omegaconf import DictConfig, OmegaConf

from benchmark.settings.composition import CONF, composing, file_groups, files_of
from benchmark.settings.overrides import quoted
from benchmark.settings.setting import SettingError, choices_of, settings_of

WIDTH = 79


def help_text(main: Callable, schema: type, name: str, module: str, flags: list[str], overrides: list[str]) -> str:
    """Settings with the values that act, after these overrides and in these files of one's own, and how to sweep."""
    primary, own = (_value(flags, f"--config-{kind}", f"-c{kind[0]}") for kind in ("name", "dir"))
    folders = [files_of(name), own and str(Path(own).resolve())]
    if own and not Path(own).is_dir():
        raise SettingError(f"--config-dir {own} is no folder.")
    if own and Path(own, f"{primary}.yaml").is_file():  # Hydra looks for it in the first folder alone.
        folders.reverse()
    if folders[1]:
        overrides = [*overrides, f"hydra.searchpath=[{quoted(f'file://{folders[1]}')}]"]
    with composing(folders[0]):
        config = compose(primary or name, overrides)
    choices = choices_of(schema)
    lines = [f"python -m {module} [setting=value ...]", "", *textwrap.wrap(inspect.getdoc(main) or "", WIDTH), ""]
    for key, setting in settings_of(schema).items():
        value = OmegaConf.select(config, f"{key}.name" if key in choices else key)
        lines += [f"  {key}={_shown(value)}", *_indented(setting.text)]
    for group in file_groups(name):
        lines.append(f"  {group}=null")
        for file in sorted(file for folder in (CONF, own) if folder for file in Path(folder, group).glob("*.yaml")):
            lines += _indented(f"{file.stem}: {_header(file)}", 8)
    lines += ["", *textwrap.wrap(f"{SWEEPS}", WIDTH)]
    return "\n".join(lines)


SWEEPS = (
    "Settings are Hydra's overrides, and its flags work: -m sweeps over values that commas part, choice(), range() or "
    "glob() (on a cluster with hydra/launcher=submitit_slurm), --cfg job prints the settings, --info where they come "
    "from, --config-dir adds a folder of your own files, -sc install=bash completes."
)


def _value(flags: list[str], *names: str) -> str | None:
    """What a flag was given, by any of its names; None without it."""
    return next((value for flag, value in pairwise(flags) if flag in names), None)


def _shown(value: object) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return str(value).lower()
        case DictConfig():
            return ""
    return str(OmegaConf.to_container(value) if OmegaConf.is_config(value) else value)


def _indented(text: str, hanging: int = 6) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=" " * 6, subsequent_indent=" " * hanging)


def _header(file: Path) -> str:
    comments = takewhile(lambda line: line.startswith("#"), file.read_text().splitlines())
    return " ".join(comment.lstrip("# ") for comment in comments if not comment.startswith("# @"))
