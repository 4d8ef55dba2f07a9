"""A suite: named conditions, on all of which a method is rolled out. Each is a file of `conf/suite/`."""

from collections.abc import Mapping
from typing import cast

from omegaconf import DictConfig, OmegaConf

from benchmark.settings.composition import CONF
from benchmark.settings.config import ConditionConfig, RunConfig
from benchmark.settings.scenes import TABLES
from benchmark.settings.setting import SettingError

SUITES = CONF / "suite"


def suites() -> list[str]:
    """Names of all suites."""
    return sorted(file.stem for file in SUITES.glob("*.yaml"))


def suite_conditions(name: str) -> dict[str, ConditionConfig]:
    """The conditions of a suite by their names, in the order in which they are shown; each says its task.

    Raises:
        SettingError: If there is no such suite.
    """
    said = _suite(name)
    usual = OmegaConf.structured(ConditionConfig(task=said.get("task", RunConfig.task)))
    return {
        str(condition): cast(ConditionConfig, OmegaConf.to_object(OmegaConf.merge(usual, values)))
        for condition, values in said.conditions.items()
    }


def tasks_of(conditions: Mapping[str, ConditionConfig]) -> list[str]:
    """The tasks of conditions that say theirs, each once, in the order in which they come."""
    return [*dict.fromkeys(condition.task for condition in conditions.values())]


def suite_scenes(name: str) -> range:
    """Scenes of which a suite's ceilings are: its own, if its file names the first one, and else those for tables.

    Raises:
        SettingError: If there is no such suite.
    """
    said = _suite(name)
    return range(said.seed_start, said.seed_start + said.episodes) if "seed_start" in said else TABLES


def _suite(name: str) -> DictConfig:
    """What a suite's file says, with what those say that it begins from (Hydra's `defaults`)."""
    if name not in suites():
        raise SettingError(f"suite={name} is not allowed. Allowed: {', '.join(suites())}.")
    said = cast(DictConfig, OmegaConf.load(SUITES / f"{name}.yaml"))
    begun = [_suite(each) for each in said.pop("defaults", []) if each != "_self_"]
    return cast(DictConfig, OmegaConf.merge(*begun, said))
