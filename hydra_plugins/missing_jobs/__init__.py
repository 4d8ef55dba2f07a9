"""A plugin of Hydra's: the sweeper of `benchmark.run`. Hydra takes plugins from this folder only."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf


class MissingJobsSweeper(BasicSweeper):
    """Hydra's sweeper, all combinations, but what is stored is not launched, and one failed job stops no other."""

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Hydra's, with the job of a sweep in place of what the command does."""
        from benchmark.sweeps.sweep import run_job

        super().setup(hydra_context=hydra_context, task_function=run_job, config=config)

    def sweep(self, arguments: list[str]) -> None:
        """Launch what is missing of all combinations."""
        from benchmark.sweeps.sweep import run_sweep

        run_sweep(list(self.jobs(arguments)), self.launcher, Path(self.config.hydra.sweep.dir))

    def jobs(self, arguments: list[str]) -> Iterator[tuple[list[str], DictConfig]]:
        """All combinations, and the settings that each makes.

        Hydra composes each choice of groups once: for every job it would be a tenth of a second.
        """
        from benchmark.settings.command import is_group

        parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
        (jobs,) = self.split_arguments(parser.parse_overrides([*self._parse_config(), *arguments]), None)

        @cache
        def compose(groups: tuple[str, ...]) -> DictConfig:
            config = self.hydra_context.config_loader.load_sweep_config(self.config, list(groups))
            return OmegaConf.masked_copy(config, [key for key in config if key != "hydra"])

        for job in jobs:
            groups = tuple(override for override in job if is_group(override.partition("=")[0]))
            config = compose(groups).copy()
            for override in parser.parse_overrides([override for override in job if override not in groups]):
                OmegaConf.update(config, override.key_or_group, override.value())
            yield job, config
