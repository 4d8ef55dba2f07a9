"""What methods come to on each condition of a suite, and all that is shown of one."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.episodes.arm import of_arm, suite_arms
from benchmark.scoring.ceiling import Ceiling, read_ceilings
from benchmark.scoring.decision_time import with_times
from benchmark.scoring.statistics import Crossed, clustered_mean
from benchmark.scoring.suite_ranking import REFERENCES, method_pairs, ranking_text, remarks, suite_ranking
from benchmark.settings.config import ConditionConfig
from benchmark.settings.scenes import FIRST_TEST_SEED, TABLES
from benchmark.settings.setting import SettingError
from benchmark.settings.suite import suite_conditions, suite_task, suites
from policies.methods import DIRECT

if TYPE_CHECKING:
    import pandas as pd

    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task


def by_condition(rows: "pd.DataFrame", arms: "Mapping[str, PlacedArm]") -> "dict[str, pd.DataFrame]":
    """The rows of the arm of each condition of a suite, by the condition's name."""
    return {name: of_arm(rows, arm) for name, arm in arms.items()}


def suite_table(
    tables: "Mapping[str, pd.DataFrame]",
    conditions: Mapping[str, ConditionConfig],
    ceilings: Mapping[str, Ceiling],
    task: "Task",
) -> "pd.DataFrame":
    """A row for each condition and method: n, the score that ranks with its interval for other trainings and scenes,
    and the paired difference to direct transfer; `ceiling` with its interval on the same scenes, NaN where none is
    frozen.

    Args:
        tables: Rows of each condition (`by_condition`).
        conditions: The suite's.
        ceilings: Of its conditions, frozen.
        task: What the rows are of.
    """
    import pandas as pd

    from benchmark.scoring.statistics import clustered_difference

    name, shown = task.ranking[0], []
    for condition, rows in tables.items():
        direct = rows[rows.method == "direct"]
        frozen = ceilings.get(condition)
        for (method, scale), group in rows.groupby(["method", "lambda"], sort=True):
            scenes = sorted({*group.episode_seed})
            pairs = group.merge(direct, on=["checkpoint_hash", "episode_seed"], suffixes=("", "_direct"))
            less = pairs[name].astype(float) - pairs[f"{name}_direct"].astype(float)
            at_most = (np.nan,) * 3 if frozen is None or not {*scenes} <= {*frozen.scenes} else frozen.interval(scenes)
            row = {"condition": condition, "saturated": conditions[condition].saturated, "method": method}
            row |= {"lambda": scale, "n": len(group), "scenes": len(scenes)}
            for key, interval in (
                (name, clustered_mean(Crossed.of(group, group[name]))),
                ("difference", clustered_difference(Crossed.of(pairs, less)) if len(pairs) else (np.nan,) * 3),
                ("ceiling", at_most),
            ):
                row |= dict(zip((key, f"{key}_low", f"{key}_high"), interval, strict=True))
            shown.append(row)
    return pd.DataFrame(shown)


def suite_text(table: "pd.DataFrame", task: "Task") -> str:
    """The table for people, in Markdown; percent and points."""
    import pandas as pd

    from benchmark.scoring.scores import difference_text, with_interval

    name = task.ranking[0]
    lines = [
        {
            "condition": row.condition,
            "method": row.method,
            "λ": f"{row['lambda']:g}",
            "n": row.n,
            name: with_interval(row, name),
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
    arms: "Mapping[str, PlacedArm]"
    """Of the conditions."""
    ranking: "pd.DataFrame"
    """A row for each method and scale (`suite_ranking.suite_ranking`); empty where there are no rows."""
    table: "pd.DataFrame"
    """A row for each condition, method and scale (`suite_table`)."""
    remarks: tuple[str, ...]
    """What there is to say of the ranking."""

    @property
    def text(self) -> list[str]:
        """The ranking and what there is to say of it, for people."""
        return [] if self.ranking.empty else [*filter(None, [ranking_text(self.ranking), *self.remarks])]

    @property
    def ranks(self) -> bool:
        """Whether there is a condition on which something is to be gained."""
        return not all(condition.saturated for condition in self.conditions.values())

    @property
    def methods(self) -> list[tuple[str, float]]:
        """Those that have rows, with their scales, the best first; without references."""
        shown = self.ranking[~self.ranking.method.isin(REFERENCES)]
        return [*zip(shown.method, shown["lambda"], strict=True)]


def standing(
    suite: str,
    conditions: Mapping[str, ConditionConfig],
    arms: "Mapping[str, PlacedArm]",
    ceilings: Mapping[str, Ceiling],
    rows: "pd.DataFrame",
    task: "Task",
) -> Standing:
    """What methods come to on a suite.

    Args:
        suite: Its name.
        conditions: Its conditions.
        arms: Of these.
        ceilings: Of these, frozen.
        rows: Of episodes.
        task: What they are of.
    """
    tables = by_condition(rows, arms)
    counted = [name for name, condition in conditions.items() if not condition.saturated]
    pairs = method_pairs(tables, conditions, ceilings, task)
    ranking = pairs if pairs.empty else with_times(suite_ranking(pairs, counted), task.name)
    said = () if pairs.empty else tuple(remarks(ranking, suite, counted, ceilings))
    return Standing(suite, conditions, arms, ranking, suite_table(tables, conditions, ceilings, task), said)


def standings(folder: Path, rows: "pd.DataFrame", task: "Task") -> list[Standing]:
    """What methods come to on each suite of a task whose ceilings are frozen for test scenes, on these scenes; those
    with head-room first.

    Args:
        folder: Ceilings are frozen in `suites/<suite>/ceilings.json` below it.
        rows: Of episodes.
        task: What they are of.
    """
    found = []
    for suite in (name for name in suites() if suite_task(name) == task.name):
        ceilings = read_ceilings(folder / "suites" / suite / "ceilings.json")
        scenes = {scene for ceiling in ceilings.values() for scene in ceiling.scenes}
        if scenes and min(scenes) >= FIRST_TEST_SEED:
            conditions, of_scenes = suite_conditions(suite), rows[rows.episode_seed.isin(scenes)]
            found.append(standing(suite, conditions, suite_arms(conditions, task), ceilings, of_scenes, task))
    return sorted((each for each in found if not each.ranking.empty), key=lambda each: not each.ranks)


def gains_text(of: Standing, task: "Task") -> str:
    """A row for each condition, a column for each method, in Markdown: what it gains over direct transfer, in points;
    what direct transfer and the ceiling come to, in percent."""
    import pandas as pd

    from benchmark.scoring.scores import difference_text, with_interval

    name, lines = task.ranking[0], []
    for condition, rows in of.table.groupby("condition", sort=False):
        by_method = {(row.method, row["lambda"]): row for _, row in rows.iterrows()}
        line = {"condition": f"{condition}{', saturated' if of.ranks and rows.saturated.iloc[0] else ''}"}
        if direct := [row for (method, _), row in by_method.items() if method == DIRECT]:
            line[DIRECT] = with_interval(direct[0], name)
            line["ceiling"] = "-" if pd.isna(direct[0].ceiling) else with_interval(direct[0], "ceiling")
        for method, scale in of.methods:
            row = by_method.get((method, scale))
            line[f"{method} {scale:g}"] = "-" if row is None else difference_text(row)
        lines.append(line)
    return pd.DataFrame(lines).fillna("-").to_markdown(index=False, disable_numparse=True)


def show_suite(
    suite: str,
    conditions: Mapping[str, ConditionConfig],
    arms: "Mapping[str, PlacedArm]",
    rows: "pd.DataFrame",
    ceilings: Mapping[str, Ceiling],
    task: "Task",
) -> None:
    """Print what rows come to on a suite, on one block of scenes: those for tables, or where none are, the others.

    Args:
        suite: Its name.
        conditions: Its conditions.
        arms: Of these.
        rows: Of episodes.
        ceilings: Of its conditions, frozen.
        task: What the rows are of.

    Raises:
        SettingError: If the rows are of none of the arms.
    """
    in_block = rows.episode_seed.isin(TABLES)
    rows = rows[in_block] if in_block.any() else rows
    of = standing(suite, conditions, arms, ceilings, rows, task)
    if of.table.empty:
        raise SettingError(
            f"These are no episodes of the conditions of suite={suite}. Roll them out: "
            f"python -m benchmark.run suite={suite} method=..."
        )
    print("\n\n".join([*of.text, suite_text(of.table, task)]))
