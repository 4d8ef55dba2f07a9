"""What a setting is: its name as typed, its description and default, and the error of a value that it cannot have."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterable
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import cache
from typing import Any, get_args, get_origin

from omegaconf import OmegaConf

PYTHON_NAME = {"lambda": "guidance_scale"}
"""Settings whose name cannot be a field in Python."""

TYPED_NAME = {python: typed for typed, python in PYTHON_NAME.items()}


class SettingError(ValueError):
    """A setting has a value that it cannot have; the message names the setting, the value and what is allowed."""


class Raised(BaseException):
    """What is wrong, as its cause, on its way through Hydra, which would print lines of its own about an exception."""


def check_setting(condition: bool, name: str, value: Any, allowed: str) -> None:
    """Raise `SettingError` unless the condition holds."""
    if not condition:
        raise SettingError(f"{name}={value} is not allowed. Allowed: {allowed}.")


def check_choice(name: str, value: Any, allowed: Iterable[str]) -> None:
    """Raise `SettingError` unless the value is one of these."""
    allowed = tuple(allowed)
    check_setting(value in allowed, name, value, ", ".join(allowed))


def check_counts(config: Any, *names: str) -> None:
    """Raise `SettingError` unless these fields of a schema are 1 or more."""
    for name in names:
        check_setting(getattr(config, name) >= 1, name, getattr(config, name), "a whole number >= 1")


@dataclass(frozen=True)
class Setting:
    """One setting of a command."""

    text: str
    """The docstring below its field."""
    default: Any
    """The schema's; what acts may come from a file of `conf/`."""
    kind: type = object
    """`str` for a text or a choice, `list` for a list of texts."""
    choices: tuple[str, ...] = ()
    """Of a setting that picks one of several groups of values."""


def settings_of(schema: type, prefix: str = "") -> dict[str, Setting]:
    """Every setting of a schema by its name on the command line."""
    texts, settings = _docstrings(schema), {}
    for field in fields(schema):
        if get_origin(field.type) is dict:  # Only for callers from Python.
            continue
        name = prefix + TYPED_NAME.get(field.name, field.name)
        text = f"{texts.get(field.name, '')} {field.metadata.get('more', '')}".strip()
        if not is_dataclass(field.type):
            settings[name] = Setting(text, _default(field), _kind(field.type))
            continue
        assert isinstance(field.type, type)
        of_field = settings_of(field.type, f"{name}.")
        if choices := field.metadata.get("choices"):  # The choice sets `<name>.name`.
            settings[name] = Setting(text, _default(field).name, str, tuple(choices))
            of_field.pop(f"{name}.name")
            of_field = of_field if "custom" in choices else {}  # A choice among known ones leaves nothing else to set.
        settings |= of_field
    return settings


def choices_of(schema: type) -> dict[str, tuple[str, ...]]:
    """The settings that pick one of several groups of values, and what each can be."""
    return {field.name: tuple(field.metadata["choices"]) for field in fields(schema) if "choices" in field.metadata}


def as_typed(schema: type) -> dict[str, Any]:
    """The schema's defaults as plain values under the names that people type."""
    plain = OmegaConf.to_container(OmegaConf.structured(schema))
    assert isinstance(plain, dict)
    return {TYPED_NAME.get(str(key), str(key)): value for key, value in plain.items()}


@cache
def _docstrings(schema: type) -> dict[str, str]:
    """The text below each field, of the schema and of those that it extends."""
    texts = {}
    for each in reversed([each for each in schema.__mro__ if is_dataclass(each)]):
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        assert isinstance(definition, ast.ClassDef)
        for field_node, text_node in zip(definition.body, definition.body[1:], strict=False):
            match field_node, text_node:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    texts[name] = " ".join(text.split())
    return texts


def short(text: str) -> str:
    """A description that fits into an error."""
    if len(text) <= 160:
        return text
    return re.split(r"[;.] ", text, maxsplit=1)[0].rstrip(".") + "."


def _kind(hint: Any) -> type:
    first = get_args(hint)[:1]
    if hint is str or (first == (str,) and get_origin(hint) is not list):
        return str
    return list if first == (str,) else object


def _default(field: Field) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()
