"""Arguments of a command as people type them: Hydra's flags, and overrides `setting=value`."""

import difflib
import os
import re
from collections.abc import Container, Iterable, Mapping, Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException

from benchmark.settings.setting import Setting, SettingError

PRINTED = ("job", "hydra", "all")
"""What --cfg can be asked for."""

INFOS = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
"""What --info can be asked for, if for anything."""

FLAGS = {
    **dict.fromkeys(["--help", "-h", "--hydra-help", "--version", "--resolve", "--run", "-r", "--multirun", "-m"]),
    **dict.fromkeys(["--shell-completion", "-sc"]),
    **dict.fromkeys(["--package", "-p", "--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd"], ()),
    **dict.fromkeys(["--cfg", "-c"], PRINTED),
    **dict.fromkeys(["--info", "-i"], INFOS),
}
"""Hydra's flags, and what value each takes: none, any, or one of these."""


def split(arguments: Iterable[str]) -> tuple[list[str], list[str]]:
    """Flags with their values, and overrides.

    Raises:
        SettingError: If a flag is none of Hydra's, or has a value that it cannot have.
    """
    flags, overrides, left = [], [], [*arguments]
    while left:
        argument = left.pop(0)
        if not argument.startswith("-"):
            overrides.append(argument)
            continue
        flag, equals, value = argument.partition("=")
        if flag not in FLAGS:
            name = flag.lstrip("-")
            raise SettingError(f"There is no flag {flag}. A setting is written without dashes: {name}=value.")
        flags.append(flag)
        allowed, optional = FLAGS[flag], flag in ("--info", "-i")
        if allowed is None or (optional and not equals and (not left or left[0] not in INFOS)):
            continue
        if not equals and not left:
            raise SettingError(f"{flag} needs a value: {', '.join(allowed) or 'a folder or a name'}.")
        flags.append(value if equals else left.pop(0))
        if allowed and flags[-1] not in allowed:
            raise SettingError(f"{flag} {flags[-1]} is not allowed. Allowed: {', '.join(allowed)}.")
    return flags, overrides


def named(overrides: Sequence[str], positional: Sequence[str], known: Container[str]) -> list[str]:
    """The overrides, in which the first arguments that are not setting=value have the names of these settings. A path
    that is there is no setting=value, unless what stands before its = is a known setting."""

    def is_bare(argument: str) -> bool:
        name, equals, _ = argument.partition("=")
        return not argument.startswith("~") and (not equals or (name not in known and os.path.exists(argument)))

    bare = [argument for argument in overrides if is_bare(argument)]
    names: dict[str, list[str]] = {}
    for name, argument in zip(positional, bare, strict=False):
        names.setdefault(argument, []).append(name)
    return [f"{names[each].pop(0)}={each}" if names.get(each) else each for each in overrides]


SUITES_OWN = ("task", "robot", "robots", "setting", "settings", "arm", "seed")
"""Settings in place of which a suite has others; of its training seeds `seeds` chooses some."""


def checked(overrides: Iterable[str], known: Mapping[str, Setting], name: str, sweeps: bool) -> list[str]:
    """The overrides, each text quoted where Hydra would read it otherwise, lists in brackets.

    Args:
        overrides: As typed.
        known: The command's settings, and its groups of files.
        name: Of the command.
        sweeps: Whether commas part the values of a sweep.

    Raises:
        SettingError: If one is no override, or of no setting, or one is given twice, or one does nothing.
    """
    given, readable = set(), []
    for override in overrides:
        key, equals, value = override.partition("=")
        key = key.lstrip("+~").partition("@")[0]
        if not equals and not override.startswith("~"):
            raise SettingError(f"{override!r} is not setting=value. {_where(name)}")
        if not key.startswith("hydra"):
            if override.startswith("~"):
                raise SettingError(f"{override} would take a setting away. Give it a value: {key}=value.")
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f"Did you mean {close[0]!r}? " if close else ""
                raise SettingError(f"There is no setting {key!r}. {hint}{_where(name)}")
            if key in given:
                raise SettingError(f"{key} is given twice. Give it once.")
            given.add(key)
        if key in known and known[key].choices and (re.fullmatch(r"\[.*\]", value) or value == "null"):
            a, b, *_ = known[key].choices
            raise SettingError(
                f"{override} is not allowed: it is one of {a}, {b} … To sweep over several: -m {key}={a},{b}"
            )
        if key in known and isinstance(known[key].default, list) and value and not sweeps and value[0] not in "[$'\"":
            override, value = f"{key}=[{value}]", f"[{value}]"  # A list may be written as a sweep's values are.
        readable.append(_readable(override, key, value, known.get(key, Setting("", None)), sweeps))
    if "suite" in given and (idle := [key for key in given if key.partition(".")[0] in SUITES_OWN]):
        raise SettingError(
            f"{idle[0]} does nothing with a suite, which has its own. Leave it out (seeds=[42] takes one policy)."
        )
    return readable


def _readable(override: str, key: str, value: str, setting: Setting, sweeps: bool) -> str:
    """An override that Hydra can read; texts in quotes where Hydra would not take them as they are."""
    kind = setting.kind
    try:
        parsed = OverridesParser.create().parse_override(override)
        swept = parsed.is_sweep_override()
        if swept and not sweeps and not key.startswith("hydra"):
            quote = f" {how_to_quote(key, value)}" if kind is str and not setting.choices else ""
            raise SettingError(f"{override} has several values. To sweep over them, add -m.{quote}")
        if swept or _fits(parsed.value(), kind):
            return override
    except HydraException as error:
        if not (kind is str or (kind is list and value.startswith("[") and value.endswith("]"))):
            why = str(error).splitlines()[0]
            raise SettingError(f"{override} cannot be read: {why}. {how_to_quote(key, value)}") from error
    except SettingError:
        raise
    except ValueError as error:  # Python reads no whole number of more than 4,300 digits.
        raise SettingError(f"{key} cannot be read: it is a number of {len(value):,} digits.") from error
    head = override[: len(override) - len(value)]
    if kind is list:
        items = re.findall(r"""\s*("[^"]*"|'[^']*'|[^,]*?)\s*,""", value[1:-1] + ",")  # In quotes may be commas.
        return f"{head}[{','.join(item if item[:1] in ('"', "'") else quoted(item) for item in items)}]"
    return head + ",".join(map(quoted, value.split(",") if sweeps and "[" not in value else [value]))


def _fits(value: object, kind: type) -> bool:
    """Whether Hydra read a value as what its setting holds."""
    if kind is list and isinstance(value, list):
        return all(isinstance(each, str) for each in value)
    return value is None or kind is not str or isinstance(value, str)


def quoted(text: str) -> str:
    """A text as Hydra takes it, whatever is in it."""
    return QuotedString(text, Quote.single).with_quotes()


def how_to_quote(key: str, value: str) -> str:
    """Advice to those whose value has a sign that Hydra gives a meaning."""
    signs = "one of = , ( ) [ ] { }, or with a letter beyond a to z,"
    return f"A text with {signs} stands in two pairs of quotes: '{key}=\"{value}\"'."


def _where(name: str) -> str:
    return f"See all settings: python -m {name} --help"
