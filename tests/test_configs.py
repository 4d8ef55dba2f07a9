"""Every command's settings compose, and each is described."""

import importlib
import re
from pathlib import Path

import pytest
from hydra import compose

from benchmark.settings import command
from benchmark.settings.composition import composing, files_of
from benchmark.settings.setting import settings_of

ROOT = Path(__file__).parents[1]


def commands():
    """Module, schema's name and configuration's name of each command."""
    for file in sorted(ROOT.glob("benchmark/**/*.py")):
        if found := re.search(r'^    run_command\(main, (\w+), "(\w+)"', file.read_text(), re.MULTILINE):
            yield ".".join(file.relative_to(ROOT).with_suffix("").parts), *found.groups()


@pytest.mark.parametrize("module, schema, name", [*commands()])
def test_a_command_s_settings_compose_and_are_described(module, schema, name):
    schema = getattr(importlib.import_module(module), schema)
    command.register(schema, name)
    with composing(files_of(name)):
        config = compose(name)
        if "suite" in settings_of(schema) and name != "run":  # Of which `conf/` has files.
            assert compose(name, ["suite=official"]).suite == "official"
    assert command.typed(config, schema) == schema()
    assert [setting for setting, about in settings_of(schema).items() if not about.text] == []
