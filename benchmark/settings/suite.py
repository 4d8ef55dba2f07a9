"""A suite: named conditions, on all of which a method is rolled out. Each is a file of `conf/suite/`."""

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
    """The conditions of a suite by their names, in the order in which they are shown.

    Raises:
        SettingError: If there is no such suite.
    """
    usual = OmegaConf.structured(ConditionConfig)
    return {
        str(condition): cast(ConditionConfig, OmegaConf.to_object(OmegaConf.merge(usual, said)))
        for condition, said in _suite(name).conditions.items()
    }


def suite_task(name: str) -> str:
    """What is done on all conditions of a suite.

    Raises:
        SettingError: If there is no such suite.
    """
    return str(_suite(name).get("task", RunConfig.task))


def suite_scenes(name: str) -> range:
    """Scenes of which a suite's ceilings are: its own, if its file names the first one, and else those for tables.

    Raises:
        SettingError: If there is no such suite.
    """
    said = _suite(name)
    return range(said.seed_start, said.seed_start + said.episodes) if "seed_start" in said else TABLES


def _suite(name: str) -> DictConfig:
    if name not in suites():
        raise SettingError(f"suite={name} is not allowed. Allowed: {', '.join(suites())}.")
    return cast(DictConfig, OmegaConf.load(SUITES / f"{name}.yaml"))
