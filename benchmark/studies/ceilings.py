"""The ceilings of a suite's conditions, made once from all that is stored, and frozen with the suite.

python -m benchmark.studies.ceilings suite=push-v1
python -m benchmark.studies.ceilings suite=quick
"""

from dataclasses import dataclass, field
from pathlib import Path

from benchmark.settings.command import run_command
from benchmark.settings.scenes import check_scenes
from benchmark.settings.setting import SettingError, check_counts, check_setting
from benchmark.settings.suite import suite_conditions, suite_scenes, tasks_of
from benchmark.settings.task import chosen_task


@dataclass
class CeilingsConfig:
    """Freezes the ceilings of a suite: by scene the best of planner, plain oracle and the stored methods."""

    suite: str = "push-v1"
    """Which suite (see benchmark.run)."""
    table: str = ""
    """Folder of the episodes; empty for results/suites/<suite>."""
    methods: list[str] = field(default_factory=lambda: ["direct", "paper", "projection", "reorder"])
    """Which methods take part besides the scripted oracles; in one task alone as in press_buttons.way_on_arm."""
    seed_start: int | None = None
    """Seed of the first scene; null for the suite's own scenes, or else those for tables."""
    episodes: int | None = None
    """How many scenes, a whole number >= 1; null for all of these."""
    output: str = ""
    """File that they go to, which must not be there; empty for results/suites/<suite>/ceilings.json."""

    def __post_init__(self) -> None:
        suite_conditions(self.suite)
        scenes = suite_scenes(self.suite)
        self.seed_start = scenes.start if self.seed_start is None else self.seed_start
        self.episodes = len(scenes) if self.episodes is None else self.episodes
        check_counts(self, "episodes")
        check_scenes(self.seed_start, self.episodes, self.suite)


def main(config: CeilingsConfig) -> None:
    """Write the ceiling of each condition, scene by scene, and print it beside what it is made of."""
    import pandas as pd

    from benchmark.artifacts.commit import commit
    from benchmark.episodes.table import read_present
    from benchmark.scoring.ceiling import PLAIN, PLANNER, ceiling, ceilings_file, save_ceilings
    from benchmark.scoring.scores import with_interval
    from benchmark.scoring.suite_table import by_condition

    file = Path(config.output) if config.output else ceilings_file(config.suite)
    conditions = suite_conditions(config.suite)
    tasks = [chosen_task(name) for name in tasks_of(conditions)]
    if file.exists():
        raise SettingError(f"{file} is there, and is frozen with the suite. To make others, give output=.")
    names = [task.name for task in tasks]
    for of_task, dot, _ in (method.partition(".") for method in config.methods):
        check_setting(not dot or of_task in names, "methods", config.methods, f"a dot after {' or '.join(names)} alone")
    table = Path(config.table) if config.table else ceilings_file(config.suite).parent
    read = [read_present(table, task) for task in tasks]
    rows = pd.concat([each for each in read if len(each)] or read[:1], ignore_index=True)
    if rows.empty:
        raise SettingError(f"There are no episodes of {' or '.join(task.name for task in tasks)} in {table}.")
    assert config.seed_start is not None and config.episodes is not None
    scenes = range(config.seed_start, config.seed_start + config.episodes)
    takes_part = (rows.task + "." + rows.method).isin(config.methods) | rows.method.isin(config.methods)
    rows = rows[rows.episode_seed.isin(scenes) & (takes_part | rows.method.isin([PLANNER, PLAIN]))]
    made, lines = {}, []
    for name, of_condition in by_condition(rows, conditions).items():
        try:
            made[name] = ceiling(of_condition, chosen_task(conditions[name].task).success)
        except SettingError as error:
            methods = dict.fromkeys([PLAIN, PLANNER, *(each.rpartition(".")[2] for each in config.methods)])
            raise SettingError(
                f"{name}: {error} Roll them out: python -m benchmark.run -m suite={config.suite} "
                f"method={','.join(methods)} seeds=[42,43,44] "
                f"seed_start={config.seed_start} episodes={config.episodes}"
            ) from error
        figures = dict(zip(("c", "c_low", "c_high"), made[name].interval(scenes), strict=True))
        means = {key: f"{100 * value:.1f}" for key, value in made[name].candidates.items()}
        lines.append({"condition": name, "ceiling": with_interval(figures, "c"), **means})
    about: dict[str, object] = {
        "suite": config.suite,
        "task": ", ".join(task.name for task in tasks),
        "scenes": [scenes[0], scenes[-1]],
        "commit": commit(),
    }
    about |= {"episode_version": int(rows.episode_version.max()), "episodes": len(rows)}
    about |= {"commits_of_rows": sorted({*rows.commit})}
    save_ceilings(file, made, about)
    print(pd.DataFrame(lines).fillna("-").to_markdown(index=False, disable_numparse=True))
    print(file)


if __name__ == "__main__":
    run_command(main, CeilingsConfig, "studies.ceilings")
