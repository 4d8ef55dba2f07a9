"""What `--help` says: every setting of a command with the value that it has, and what it is."""

import inspect
import textwrap
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path

from hydra import compose
from omegaconf import DictConfig, OmegaConf

from benchmark.settings.composition import CONF, composing, file_groups
from benchmark.settings.setting import choices_of, settings_of

WIDTH = 79


def help_text(main: Callable, schema: type, name: str, module: str, overrides: list[str]) -> str:
    """Settings with the values that act, after these overrides, and how to sweep."""
    with composing(name):
        config = compose(name, overrides)
    choices = choices_of(schema)
    lines = [f"python -m {module} [setting=value ...]", "", *textwrap.wrap(inspect.getdoc(main) or "", WIDTH), ""]
    for key, setting in settings_of(schema).items():
        value = OmegaConf.select(config, f"{key}.name" if key in choices else key)
        lines += [f"  {key}={_shown(value)}", *_indented(setting.text)]
    for group in file_groups(name):
        lines.append(f"  {group}=null")
        for file in sorted((CONF / group).glob("*.yaml")):
            lines += _indented(f"{file.stem}: {_header(file)}", 8)
    lines += ["", *textwrap.wrap(f"{SWEEPS}", WIDTH)]
    return "\n".join(lines)


SWEEPS = (
    "Settings are Hydra's overrides, and its flags work: -m sweeps over values that commas part, choice(), range() or "
    "glob() (on a cluster with hydra/launcher=submitit_slurm), --cfg job prints the settings, --info where they come "
    "from, --config-dir adds a folder of your own files, -sc install=bash completes."
)


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
