"""What methods come to on each condition of a suite, and all that is shown of one."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.episodes.arm import of_arm, suite_arms
from benchmark.scoring.ceiling import Ceiling, read_ceilings
from benchmark.scoring.decision_time import with_times
from benchmark.scoring.statistics import Crossed, clustered_mean
from benchmark.scoring.suite_ranking import REFERENCES, method_pairs, ranking_text, remarks, suite_ranking
from benchmark.scoring.text_table import for_terminal
from benchmark.settings.config import ConditionConfig
from benchmark.settings.scenes import FIRST_TEST_SEED
from benchmark.settings.setting import SettingError
from benchmark.settings.suite import suite_conditions, suite_scenes, suites, tasks_of
from benchmark.settings.task import chosen_task
from policies.methods import DIRECT, in_task

if TYPE_CHECKING:
    import pandas as pd

    from envs.arm.placed_arm import PlacedArm


def by_condition(rows: "pd.DataFrame", conditions: Mapping[str, ConditionConfig]) -> "dict[str, pd.DataFrame]":
    """The rows of the task and the arm of each condition of a suite, by the condition's name."""
    tasks = {name: chosen_task(name).name for name in tasks_of(conditions)}
    of_task = {name: rows if rows.empty else rows[rows.task == tasks[name]] for name in tasks}
    return {name: of_arm(of_task[conditions[name].task], arm) for name, arm in suite_arms(conditions).items()}


def suite_table(
    tables: "Mapping[str, pd.DataFrame]",
    conditions: Mapping[str, ConditionConfig],
    ceilings: Mapping[str, Ceiling],
) -> "pd.DataFrame":
    """A row for each condition and method: n, the `score` that ranks in the condition's task, which `ranked` names,
    with its interval for other trainings and scenes, and the paired difference to direct transfer; `ceiling` with its
    interval on the same scenes, NaN where none is frozen.

    Args:
        tables: Rows of each condition (`by_condition`).
        conditions: The suite's.
        ceilings: Of its conditions, frozen.
    """
    import pandas as pd

    from benchmark.scoring.statistics import clustered_difference

    shown = []
    for condition, rows in tables.items():
        about, direct = conditions[condition], rows[rows.method == "direct"] if len(rows) else rows
        name, frozen = chosen_task(about.task).ranking[0], ceilings.get(condition)
        for (method, scale), group in rows.groupby(["method", "lambda"], sort=True) if len(rows) else ():
            scenes = sorted({*group.episode_seed})
            pairs = group.merge(direct, on=["checkpoint_hash", "episode_seed"], suffixes=("", "_direct"))
            less = pairs[name].astype(float) - pairs[f"{name}_direct"].astype(float)
            at_most = (np.nan,) * 3 if frozen is None or not {*scenes} <= {*frozen.scenes} else frozen.interval(scenes)
            row = {"condition": condition, "task": about.task, "ranked": name, "saturated": about.saturated}
            row |= {"method": method, "lambda": scale, "n": len(group), "scenes": len(scenes)}
            for key, interval in (
                ("score", clustered_mean(Crossed.of(group, group[name].astype(float)))),
                ("difference", clustered_difference(Crossed.of(pairs, less)) if len(pairs) else (np.nan,) * 3),
                ("ceiling", at_most),
            ):
                row |= dict(zip((key, f"{key}_low", f"{key}_high"), interval, strict=True))
            shown.append(row)
    return pd.DataFrame(shown)


def suite_text(table: "pd.DataFrame") -> str:
    """The table for people, in Markdown; percent and points."""
    import pandas as pd

    from benchmark.scoring.scores import difference_text, with_interval

    score = table.ranked.iloc[0] if table.ranked.nunique() == 1 else "score"
    lines = [
        {
            "condition": row.condition,
            "method": row.method,
            "λ": f"{row['lambda']:g}",
            "n": row.n,
            score: with_interval(row, "score"),
            "minus direct": "-" if row.method == "direct" else difference_text(row),
            f"ceiling of these {row.scenes} scenes" if table.scenes.nunique() == 1 else "ceiling of its scenes": "-"
            if pd.isna(row.ceiling)
            else with_interval(row, "ceiling"),
        }
        for _, row in table.iterrows()
    ]
    return pd.DataFrame(lines).to_markdown(index=False, disable_numparse=True)


@dataclass(frozen=True)
class Standing:
    """What methods come to on a suite, on some scenes."""

    suite: str
    conditions: Mapping[str, ConditionConfig]
    ranking: "pd.DataFrame"
    """A row for each method and scale (`suite_ranking.suite_ranking`); empty where there are no rows."""
    table: "pd.DataFrame"
    """A row for each condition, method and scale (`suite_table`)."""
    remarks: tuple[str, ...]
    """What there is to say of the ranking."""

    @cached_property
    def arms(self) -> "dict[str, PlacedArm]":
        """Of the conditions."""
        return suite_arms(self.conditions)

    @property
    def text(self) -> list[str]:
        """The ranking and what there is to say of it, for people."""
        return [] if self.ranking.empty else [*filter(None, [ranking_text(self.ranking), *self.remarks])]

    @property
    def ranks(self) -> bool:
        """Whether there is a condition on which something is to be gained."""
        return not all(condition.saturated for condition in self.conditions.values())

    @property
    def methods(self) -> "pd.DataFrame":
        """The ranking without references."""
        return self.ranking[~self.ranking.method.isin(REFERENCES)]

    def cell(self, method: "pd.Series", condition: str) -> "pd.Series | None":
        """The row of `table` of a row of the ranking on a condition; None where there is none."""
        task = self.conditions[condition].task
        rows = self.table[(self.table.condition == condition) & (self.table.method == in_task(method.method, task))]
        rows = rows[rows["lambda"] == method.scales.get(task, np.nan)]
        return None if rows.empty else rows.iloc[0]


def standing(
    suite: str,
    conditions: Mapping[str, ConditionConfig],
    ceilings: Mapping[str, Ceiling],
    rows: "pd.DataFrame",
) -> Standing:
    """What methods come to on a suite.

    Args:
        suite: Its name.
        conditions: Its conditions.
        ceilings: Of these, frozen.
        rows: Of episodes of its tasks.
    """
    tables = by_condition(rows, conditions)
    counted = [name for name, condition in conditions.items() if not condition.saturated]
    pairs = method_pairs(tables, conditions, ceilings)
    ranking = pairs if pairs.empty else with_times(suite_ranking(pairs, counted))
    said = () if pairs.empty else tuple(remarks(ranking, suite, counted, ceilings))
    return Standing(suite, conditions, ranking, suite_table(tables, conditions, ceilings), said)


def standings(folder: Path, task: str, read: "Callable[[str], pd.DataFrame]") -> list[Standing]:
    """What methods come to on each suite that has conditions of a task, and ceilings that are frozen for test scenes,
    on these scenes; those of most tasks first, and of these those with head-room.

    Args:
        folder: Ceilings are frozen in `suites/<suite>/ceilings.json` below it.
        task: Its name.
        read: Gives the rows of episodes of a task.
    """
    import pandas as pd

    found = []
    for suite in suites():
        conditions, ceilings = suite_conditions(suite), read_ceilings(folder / "suites" / suite / "ceilings.json")
        tasks, scenes = tasks_of(conditions), {scene for ceiling in ceilings.values() for scene in ceiling.scenes}
        if task in tasks and scenes and min(scenes) >= FIRST_TEST_SEED:
            of_scenes = [rows[rows.episode_seed.isin(scenes)] for rows in map(read, tasks) if len(rows)]
            together = pd.concat(of_scenes, ignore_index=True) if of_scenes else pd.DataFrame()
            found.append(standing(suite, conditions, ceilings, together))
    shown = [each for each in found if not each.ranking.empty]
    return sorted(shown, key=lambda each: (-len(tasks_of(each.conditions)), not each.ranks))


def gains_text(of: Standing) -> str:
    """A row for each condition, a column for each method, in Markdown: what it gains over direct transfer, in points;
    what direct transfer and the ceiling come to, in percent. `as direct` marks a task in which the method does nothing,
    and counts as direct transfer."""
    import pandas as pd

    from benchmark.scoring.scores import difference_text, with_interval

    lines = []
    for condition, rows in of.table.groupby("condition", sort=False):
        line = {"condition": f"{condition}{', saturated' if of.ranks and rows.saturated.iloc[0] else ''}"}
        for _, direct in rows[rows.method == DIRECT].iterrows():
            line[DIRECT] = with_interval(direct, "score")
            line["ceiling"] = "-" if pd.isna(direct.ceiling) else with_interval(direct, "ceiling")
        for _, method in of.methods.iterrows():
            row = of.cell(method, str(condition))
            lacking = "as direct" if rows.task.iloc[0] not in method.scales and method["rank"] > 0 else "-"
            line[f"{method.method} {method['lambda']}"] = lacking if row is None else difference_text(row)
        lines.append(line)
    return pd.DataFrame(lines).fillna("-").to_markdown(index=False, disable_numparse=True)


def show_suite(
    suite: str, conditions: Mapping[str, ConditionConfig], rows: "pd.DataFrame", ceilings: Mapping[str, Ceiling]
) -> Standing:
    """Print what rows come to on a suite, on one block of scenes: those of its ceilings, or where none are, the others;
    gives it.

    Args:
        suite: Its name.
        conditions: Its conditions.
        rows: Of episodes of its tasks.
        ceilings: Of its conditions, frozen.

    Raises:
        SettingError: If the rows are of none of the arms.
    """
    in_block = rows.episode_seed.isin(suite_scenes(suite))
    of = standing(suite, conditions, ceilings, rows[in_block] if in_block.any() else rows)
    if of.table.empty:
        raise SettingError(
            f"These are no episodes of the conditions of suite={suite}. Roll them out: "
            f"python -m benchmark.run suite={suite} method=..."
        )
    print(for_terminal("\n\n".join([*of.text, suite_text(of.table)])))
    return of
