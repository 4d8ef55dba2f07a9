"""The door of every command: settings from the command line through Hydra, one line for what is wrong with them."""

import ast
import difflib
import inspect
import os
import sys
import textwrap
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import reduce
from itertools import takewhile
from pathlib import Path
from typing import Any, NoReturn, get_origin

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

CONF = Path(__file__).parents[2] / "conf"

PYTHON_NAME = {"lambda": "guidance_scale"}
"""Settings whose name cannot be a field in Python."""


class SettingError(ValueError):
    """A setting has a value that it cannot have; the message names the setting, the value and what is allowed."""


def run_command[Config](main: Callable[[Config], None], schema: type[Config], name: str) -> None:
    """Read settings `key=value` from the command line into a `schema` and call `main` with it.

    Defaults and descriptions are those of the schema, `conf/<name>.yaml` says how it is composed, `--help` lists it.
    Wrong settings end the program with status 2 and one line, before anything heavy is imported.
    """
    if {"--help", "-h"} & set(sys.argv[1:]):
        print(_help(name, main, schema))
        return

    def enter(config: DictConfig) -> None:
        try:
            main(typed(config, schema))
        except SettingError as error:
            _refuse(error)

    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises instead of printing.
    ConfigStore.instance().store(f"{name}_schema", named_as_typed(OmegaConf.structured(schema)))
    try:
        _check_arguments([arg for arg in sys.argv[1:] if arg not in ("-m", "--multirun")], name, schema)
        sys.argv[1:] = [_as_text(arg, schema) for arg in sys.argv[1:]]
        hydra.main(version_base="1.3", config_path=str(CONF), config_name=name)(enter)()
    except (SettingError, HydraException) as error:
        _refuse(error)
    except KeyboardInterrupt:
        print("Interrupted. What was finished is stored; the same command goes on from there.", file=sys.stderr)
        sys.exit(130)


def check_setting(condition: bool, name: str, value: Any, allowed: str) -> None:
    """Raise `SettingError` unless the condition holds."""
    if not condition:
        raise SettingError(f"{name}={value} is not allowed. Allowed: {allowed}.")


def setting_texts(schema: type, prefix: str = "") -> dict[str, tuple[str, Any]]:
    """Description (the docstring below each field) and default of every setting, by its name on the command line."""
    (body,) = (node.body for node in ast.parse(textwrap.dedent(inspect.getsource(schema))).body)
    texts = {}
    for field_node, text_node in zip(body, body[1:], strict=False):
        if isinstance(field_node, ast.AnnAssign) and isinstance(text_node, ast.Expr):
            texts[field_node.target.id] = " ".join(text_node.value.value.split())
    typed_as = {python: name for name, python in PYTHON_NAME.items()}
    settings = {}
    for field in fields(schema):
        if get_origin(field.type) is dict:  # Only for callers from Python.
            continue
        name = prefix + typed_as.get(field.name, field.name)
        if not is_dataclass(field.type):
            default = field.default if field.default_factory is MISSING else field.default_factory()
            settings[name] = texts.get(field.name, ""), default
            continue
        of_field = setting_texts(field.type, f"{name}.")
        if is_group(name):  # Its choice sets `<name>.name`; a choice among few arms leaves nothing else to set.
            settings[name] = texts.get(field.name, ""), None
            of_field = {} if "choices" in field.metadata else of_field
            of_field.pop(f"{name}.name", None)
        settings |= of_field
    return settings


def _refuse(error: Exception) -> NoReturn:
    print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
    sys.exit(2)


def _help(name: str, main: Callable, schema: type) -> str:
    lines = [
        f"python -m benchmark.{name} [setting=value ...]",
        "",
        *textwrap.wrap(inspect.getdoc(main), 100),
        "",
    ]
    for key, (text, default) in setting_texts(schema).items():
        shown = f"{key}={_default_choice(name, key) if is_group(key) else default}"
        lines += [f"  {shown}", *textwrap.wrap(text, 92, initial_indent=" " * 6, subsequent_indent=" " * 6)]
    for key, choices in _presets(name).items():
        lines += [f"  {key}=null"]
        for choice, text in choices.items():
            lines += textwrap.wrap(f"{choice}: {text}", 92, initial_indent=" " * 6, subsequent_indent=" " * 8)
    return "\n".join(lines)


def _check_arguments(arguments: list[str], name: str, schema: type) -> None:
    """Refuse what is no setting, settings that do not exist, and choices that a group does not have."""
    presets = _presets(name)
    known, given = [*setting_texts(schema), *presets], set()
    for argument in arguments:
        try:
            override = OverridesParser.create().parse_override(argument)
        except HydraException as error:
            raise SettingError(f"{argument!r} is not setting=value. Settings: {', '.join(known)}.") from error
        key = override.key_or_group
        if key.startswith("hydra"):
            continue
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f" Did you mean {close[0]!r}?" if close else ""
            raise SettingError(f"There is no setting {key!r}.{hint} Settings: {', '.join(known)}.")
        if key in given:
            raise SettingError(f"{key} is given twice. Give it once.")
        given.add(key)
        if is_group(key):
            choices = [*presets[key]] if key in presets else _choices(key, schema)
            for value in override.sweep_string_iterator() if override.is_choice_sweep() else [override.value()]:
                check_setting(value in choices, key, value, ", ".join(choices))


def _as_text(argument: str, schema: type) -> str:
    """An argument whose setting is a text, quoted where Hydra would read a number: row=4787e758 is no 4787 · 10^758."""
    key, _, value = argument.partition("=")
    kind: Any = schema
    for part in key.split("."):
        types = {each.name: each.type for each in fields(kind)} if is_dataclass(kind) else {}
        kind = types.get(PYTHON_NAME.get(part, part))
    if kind is not str or not isinstance(OverridesParser.create().parse_override(argument).value(), int | float):
        return argument
    return f"{key}='{value}'"


def typed[Config](config: DictConfig, schema: type[Config]) -> Config:
    """The composed settings as an object of the schema."""
    try:
        values = {PYTHON_NAME.get(str(key), str(key)): value for key, value in config.items()}
        return OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(schema), values))
    except OmegaConfBaseException as error:
        texts = setting_texts(schema)
        key = next((name for name, python in PYTHON_NAME.items() if python == error.full_key), error.full_key)
        text = texts.get(str(key), ("",))[0]
        raw = OmegaConf.to_container(config, resolve=False)
        value = reduce(lambda node, part: node[part], str(key).split("."), raw) if str(key) in texts else ""
        raise SettingError(f"{key}={value} is not allowed. {key}: {text}") from error


def named_as_typed(config: DictConfig) -> dict[str, Any]:
    """The schema's defaults as plain values under the names that people type."""
    plain = OmegaConf.to_container(config)
    typed_as = {python: name for name, python in PYTHON_NAME.items()}
    return {typed_as.get(key, key): value for key, value in plain.items()}


def is_group(key: str) -> bool:
    """Whether a setting picks a file of values."""
    return (CONF / key).is_dir()


def _choices(group: str, schema: type) -> list[str]:
    """What a group can be set to: what the field's metadata name, or else every file of the group."""
    (field,) = (field for field in fields(schema) if field.name == group)
    return sorted(field.metadata.get("choices", (file.stem for file in (CONF / group).glob("*.yaml"))))


def _presets(name: str) -> dict[str, dict[str, str]]:
    """The groups of which a command takes none by default: each choice, and what its file says about itself."""
    defaults = OmegaConf.load(CONF / f"{name}.yaml").defaults
    groups = [group for entry in defaults if not isinstance(entry, str) for group in entry if entry[group] is None]
    return {group: {file.stem: _header(file) for file in sorted((CONF / group).glob("*.yaml"))} for group in groups}


def _header(file: Path) -> str:
    comments = takewhile(lambda line: line.startswith("#"), file.read_text().splitlines())
    return " ".join(comment.lstrip("# ") for comment in comments if not comment.startswith("# @"))


def _default_choice(name: str, group: str) -> str:
    defaults = OmegaConf.load(CONF / f"{name}.yaml").defaults
    return next(entry[group] for entry in defaults if not isinstance(entry, str) and group in entry)
