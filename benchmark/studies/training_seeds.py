"""Direct transfer by training seed: how much a policy's training decides on each condition of a suite.

python -m benchmark.source_policies seeds=[45,46,47,48,49,50,51] best=1
python -m benchmark.run suite=push-v1 method=direct seeds=[45,46,47,48,49,50,51] seed_start=150000 episodes=100
python -m benchmark.studies.training_seeds
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.paths import check_file
from benchmark.settings.scenes import TABLES
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.suite import suite_conditions, tasks_of
from benchmark.settings.task import chosen_task
from policies.methods import DIRECT

if TYPE_CHECKING:
    import pandas as pd

PUBLISHED = (42, 43, 44)
"""Training seeds of the policies that ship."""


@dataclass
class TrainingSeedsConfig:
    """Writes what direct transfer comes to on a suite's conditions by training seed."""

    suite: str = "push-v1"
    """Which suite, of one task (see benchmark.run)."""
    table: str = ""
    """Folder of the episodes; empty for results/suites/<suite>."""
    output: str = "results/training_seeds.md"
    """File that the table goes to."""

    def __post_init__(self) -> None:
        one = len(tasks_of(suite_conditions(self.suite))) == 1
        check_setting(one, "suite", self.suite, "a suite of one task")
        self.table = self.table or f"results/suites/{self.suite}"
        check_setting(Path(self.table).exists(), "table", self.table, "a folder of episodes")
        check_file(self.output)


TEXT = """# Direct transfer by training seed

Suite `{suite}`, scenes {first} to {last}, {number} trainings of {scenes} episodes each on every condition; {score} in
percent. Intervals are for other trainings and other scenes ([protocol](../docs/protocol.md#statistics)). Made by
`python -m benchmark.studies.training_seeds` from rows of `python -m benchmark.run suite={suite} method=direct
seed_start={first} episodes={scenes}` with all of these seeds. The policies of seeds 42, 43 and 44 ship; the others are
made by `python -m benchmark.source_policies seeds=[{others}] best=1`, and their rows are not kept here.

"""


def by_training(tables: "dict[str, pd.DataFrame]", score: str) -> "pd.DataFrame":
    """A row for each condition: the score over the published trainings and over all, and of each training."""
    import pandas as pd

    from benchmark.scoring.scores import with_interval
    from benchmark.scoring.statistics import Crossed, clustered_mean

    lines = []
    for name, rows in tables.items():
        line = {"condition": name}
        of_seeds = {"the three that ship": rows[rows.training_seed.isin(PUBLISHED)], "all": rows}
        for title, some in of_seeds.items():
            interval = clustered_mean(Crossed.of(some, some[score].astype(float)))
            line[title] = with_interval(dict(zip(("x", "x_low", "x_high"), interval, strict=True)), "x")
        means = rows.groupby("training_seed")[score].mean().mul(100)
        line["standard deviation"] = f"{means.std():.1f}"
        lines.append(line | {str(seed): f"{mean:.0f}" for seed, mean in means.items()})
    return pd.DataFrame(lines)


def main(config: TrainingSeedsConfig) -> None:
    """Write the table."""
    from benchmark.episodes.table import read_present
    from benchmark.scoring.suite_table import by_condition
    from richmap.outputs import replacing

    conditions = suite_conditions(config.suite)
    task = chosen_task(*tasks_of(conditions))
    rows = read_present(Path(config.table), task)
    rows = rows if rows.empty else rows[(rows.method == DIRECT) & rows.episode_seed.isin(TABLES)]
    seeds = sorted({*rows.training_seed}) if len(rows) else []
    if len(seeds) <= len(PUBLISHED):
        raise SettingError(
            f"{config.table} holds direct transfer of {len(seeds)} training seeds on scenes {TABLES[0]} to "
            f"{TABLES[-1]}. Roll out more: python -m benchmark.run suite={config.suite} method=direct "
            f"seeds=[45,46,47,48,49,50,51] seed_start={TABLES[0]} episodes={len(TABLES)}"
        )
    tables = by_condition(rows, conditions)
    played = {name: len(table) for name, table in tables.items() if len(table) != len(seeds) * len(TABLES)}
    if played:
        raise SettingError(f"Episodes are missing: {played}, where {len(seeds) * len(TABLES)} are to be.")
    others = ",".join(str(seed) for seed in seeds if seed not in PUBLISHED)
    text = TEXT.format(
        suite=config.suite, first=TABLES[0], last=TABLES[-1], number=len(seeds), scenes=len(TABLES),
        score=task.ranking[0], others=others,
    )  # fmt: skip
    table = by_training(tables, task.ranking[0])
    with replacing(Path(config.output)) as path:
        path.write_text(text + table.to_markdown(index=False, disable_numparse=True) + "\n")
    print(config.output)


if __name__ == "__main__":
    run_command(main, TrainingSeedsConfig, "studies.training_seeds")
