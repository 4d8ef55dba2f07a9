"""Makes the scalar fields that ship, those of the suites' conditions, so that nobody waits for maps.

python -m benchmark.studies.shipped_fields
"""

import shutil
from dataclasses import dataclass, field, fields

from benchmark.settings.command import run_command
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.setting import check_choice, check_counts
from benchmark.settings.suite import suite_conditions, suites
from benchmark.settings.task import chosen_task
from policies.method import is_of

KINDS = ("feasibility", "reach", "branch_reach", "energy")


@dataclass
class ShippedFieldsConfig:
    """Makes fields with the usual settings of maps and of the energy, from the cache where they are there; those that
    ship already stay."""

    suites: list[str] = field(default_factory=lambda: ["push-v1", "official", "quick", "full"])
    """Whose conditions, as in suites=[quick]."""
    kinds: list[str] = field(default_factory=lambda: [*KINDS])
    """Kinds of field, as in kinds=[energy]."""
    output_dir: str = "benchmark/artifacts/shipped"
    """Folder that they go to."""
    workers: int = 2
    """Processes that sample; a whole number >= 1."""

    def __post_init__(self) -> None:
        for each in fields(self)[:2]:
            allowed = suites() if each.name == "suites" else KINDS
            for name in getattr(self, each.name):
                check_choice(each.name, name, allowed)
        check_folder(self.output_dir)
        check_counts(self, "workers")


def main(config: ShippedFieldsConfig) -> None:
    """Make each field that is not there yet, and say what it takes."""
    from pathlib import Path

    from benchmark.artifacts.fields import guidance_field
    from benchmark.episodes.arm import suite_arms
    from richmap.outputs import replacing
    from richmap.progress import plain_console

    console, folder = plain_console(), Path(config.output_dir)
    for kind in config.kinds:
        for suite in config.suites:
            conditions = suite_conditions(suite).items()
            made = {name: each for name, each in conditions if is_of(kind, chosen_task(each.task).space)}
            for name, arm in suite_arms(made).items():
                _, file = guidance_field(kind, arm, MapConfig(), EnergyConfig(), config.workers, console)
                assert file is not None
                if not (folder / file.name).exists():
                    with replacing(folder / file.name) as path:
                        shutil.copyfile(file, path)
                    console.print(f"{suite}, {name}: {file.name}, {file.stat().st_size // 1000} kB", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, ShippedFieldsConfig, "studies.shipped_fields")
