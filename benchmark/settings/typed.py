"""The composed settings as an object of their schema."""

import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import reduce
from typing import Any, cast

from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException

from benchmark.settings.limits import check_limits
from benchmark.settings.setting import PYTHON_NAME, TYPED_NAME, Setting, SettingError, choices_of, settings_of, short

MOST = sys.float_info.max
NESTED = ".ignore"
"""How the names of lists of lists end."""


def typed[Config](config: DictConfig, schema: type[Config]) -> Config:
    """The composed settings as an object of the schema.

    Raises:
        SettingError: If one has a value that it cannot have.
    """
    known = {TYPED_NAME.get(field.name, field.name) for field in fields(schema)}  # type: ignore[arg-type]
    if unknown := [str(key) for key in config if str(key) not in known]:
        raise _unknown(unknown[0])
    try:
        # Interpolations are resolved as `items` reads them: what a text holds now is meant as it stands.
        values = {PYTHON_NAME.get(str(key), str(key)): literal(value) for key, value in config.items()}
        for key in choices_of(schema):
            if isinstance(name := values.get(key), str):  # As files say it that are composed with the others.
                values[key] = {"name": name}
        for group in fields(schema):  # type: ignore[arg-type]
            given = values.get(group.name, {})
            if is_dataclass(group.type) and not isinstance(given, dict | DictConfig):
                raise SettingError(f"{group.name}={given} is not allowed. It is settings by name, as in a file.")
        _check_kinds(values, settings_of(schema))
        merged = OmegaConf.merge(OmegaConf.structured(schema), values)
        plain: Any = OmegaConf.to_container(merged, resolve=True)
        check_limits(_flat(plain), settings_of(schema))
        return cast(Config, OmegaConf.to_object(merged))
    except OverflowError as error:  # A whole number that no number with a fraction can be.
        raw: Any = OmegaConf.to_container(config, resolve=False)
        wrong = next((name for name, x in _flat(raw).items() if type(x) is int and abs(x) > MOST), "a setting")
        raise SettingError(f"{wrong} is not allowed: it is beyond {MOST:g}.") from error
    except OmegaConfBaseException as error:
        wrong = str(error.full_key).partition("[")[0]  # Of a list the whole.
        settings, key = settings_of(schema), TYPED_NAME.get(wrong, wrong)
        if isinstance(error, ConfigKeyError):
            raise _unknown(key) from error
        if key not in settings:
            raise SettingError(f"{key}: {' '.join(str(error.msg or error).split())}") from error
        raw = OmegaConf.to_container(config, resolve=False)
        value = reduce(lambda node, part: node[part], key.split("."), raw)
        shown = "null" if value is None else value
        raise SettingError(f"{key}={shown} is not allowed. {key}: {short(settings[key].text)}") from error


def _check_kinds(values: Mapping[Any, Any], settings: dict[str, Setting], prefix: str = "") -> None:
    """Refuse settings by name and lists where there is one value: OmegaConf takes some, or does not say where."""
    for key, value in values.items():
        name = prefix + TYPED_NAME.get(str(key), str(key))
        about, named = settings.get(name), isinstance(value, Mapping)
        if about is None or (named and about.choices):
            if named:
                _check_kinds(value, settings, f"{name}.")
            continue
        parts = value if isinstance(value, list | ListConfig) else ()
        if name.endswith(NESTED):
            parts = [part for each in parts for part in (each if isinstance(each, list | ListConfig) else [each])]
        if named or any(isinstance(part, Mapping | list | ListConfig) for part in parts):
            raise SettingError(f"{name}={value} is not allowed. {name}: {short(about.text)}")


def literal(value: Any) -> Any:
    """The value; of a text what OmegaConf reads as that text, whatever interpolation it looks like."""
    return value.replace("${", r"\${") if isinstance(value, str) else value


def _unknown(key: str) -> SettingError:
    package = " A file of conf/experiment begins with the line `# @package _global_`." if key == "experiment" else ""
    return SettingError(f"There is no setting {key!r}. Take it out of the file or call that gives it.{package}")


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested values by their names on the command line."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = prefix + TYPED_NAME.get(str(key), str(key))
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat
