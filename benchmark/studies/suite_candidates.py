"""Which conditions a suite is made of: what candidates come to on validation scenes, and which of them fit the rule.

python -m benchmark.run -m suite=candidates method=direct,plain_oracle,aware_oracle
python -m benchmark.studies.suite_candidates
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.config import ConditionConfig
from benchmark.settings.paths import check_file
from benchmark.settings.scenes import VALIDATION
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.suite import suite_conditions, tasks_of
from benchmark.settings.task import chosen_task

if TYPE_CHECKING:
    import pandas as pd

    from envs.task import Task

LEAST, MOST = 0.25, 0.90
"""What direct transfer has in a condition with head-room."""
CEILING, ROOM = 0.80, 0.15
"""What the ceiling is there at least, and how far above direct transfer."""
SATURATED = 0.95
"""Direct transfer has as much in a condition that shows harm."""


@dataclass
class CandidatesConfig:
    """Writes what the candidates for a suite come to on validation scenes, and which of them fit."""

    suite: str = "candidates"
    """Which suite holds the candidates (see benchmark.run)."""
    table: str = ""
    """Folder of the episodes; empty for outputs/suites/<suite>."""
    output: str = "results/suite_candidates.md"
    """File that the table goes to."""

    def __post_init__(self) -> None:
        suite_conditions(self.suite)
        folder = self.table or f"outputs/suites/{self.suite}"
        check_setting(Path(folder).exists(), "table", folder, "a folder of episodes")
        self.table = folder
        check_file(self.output)


TEXT = """# Which conditions the suite is made of

Validation scenes alone ({first} to {last}); made by `python -m benchmark.studies.suite_candidates` from rows of
`python -m benchmark.run -m suite=candidates method=direct,plain_oracle,aware_oracle episodes=50`. {score} in
percent with 95 % intervals for other trainings and other scenes; n is of direct transfer. The ceiling is
cross-validated over policies ([protocol](../docs/protocol.md)).

**The rule**: *head-room* is where direct transfer has {least:.0%} to {most:.0%}, and the ceiling is at least
{ceiling:.0%} and at least {room:.0%} above it. *Saturated* is where direct transfer has at least {saturated:.0%}.

"""


def verdict(direct: float, ceiling: float) -> str:
    """What a condition is, by the rule."""
    if LEAST <= direct <= MOST and ceiling >= CEILING and ceiling - direct >= ROOM:
        return "head-room"
    return "saturated" if direct >= SATURATED else ""


def candidates(rows: "pd.DataFrame", conditions: dict[str, ConditionConfig], task: "Task") -> "pd.DataFrame":
    """A row for each condition of which there are rows of direct transfer."""
    import pandas as pd

    from benchmark.scoring.ceiling import ceiling
    from benchmark.scoring.scores import causes_text, with_interval
    from benchmark.scoring.statistics import Crossed, clustered_mean
    from benchmark.scoring.suite_table import by_condition

    shown = []
    for name, table in by_condition(rows, conditions).items():
        direct = table[table.method == "direct"]
        if direct.empty:
            continue
        crossed = Crossed(
            direct[task.success].to_numpy(float), direct.checkpoint.to_numpy(str), direct.episode_seed.to_numpy()
        )
        top, scenes = ceiling(table, task.success), sorted({*direct.episode_seed})
        figures = dict(zip(("d", "d_low", "d_high"), clustered_mean(crossed), strict=True))
        figures |= dict(zip(("c", "c_low", "c_high"), top.interval(scenes), strict=True))
        row = {
            "condition": name,
            "n": len(direct),
            "direct": with_interval(figures, "d"),
            "ceiling": with_interval(figures, "c"),
            **{key: f"{100 * value:.0f}" for key, value in top.candidates.items() if key != "direct"},
            "direct fails by": causes_text(direct.failure_cause.dropna().value_counts()[:3].to_dict()),
        }
        shown.append(row | {"by the rule": verdict(figures["d"], figures["c"])})
    table = pd.DataFrame(shown).fillna("-")
    last = ["direct fails by", "by the rule"]
    return table[[*(column for column in table if column not in last), *last]]


def main(config: CandidatesConfig) -> None:
    """Write the table."""
    from benchmark.episodes.table import read_tables
    from richmap.outputs import replacing

    task = chosen_task(tasks_of(suite_conditions(config.suite))[0])
    rows = read_tables(Path(config.table), task.name)
    if len(rows):
        present = rows.episode_version == rows.setting.map(task.episode_version)
        rows = rows[rows.episode_seed.isin(VALIDATION) & present]
    if rows.empty:
        raise SettingError(f"{config.table} holds no validation episodes of the present version.")
    table = candidates(rows, suite_conditions(config.suite), task)
    text = TEXT.format(
        first=rows.episode_seed.min(), last=rows.episode_seed.max(), score=task.success, least=LEAST, most=MOST,
        ceiling=CEILING, room=ROOM, saturated=SATURATED,
    )  # fmt: skip
    with replacing(Path(config.output)) as path:
        path.write_text(text + table.to_markdown(index=False, disable_numparse=True) + "\n")
    print(config.output)


if __name__ == "__main__":
    run_command(main, CandidatesConfig, "studies.suite_candidates")
