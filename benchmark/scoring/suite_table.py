"""What methods come to on each condition of a suite, and all that is shown of one."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.episodes.arm import of_arm, suite_arms
from benchmark.scoring.ceiling import Ceiling, read_ceilings
from benchmark.scoring.statistics import Crossed, clustered_mean
from benchmark.scoring.suite_ranking import method_pairs, ranking_text, remarks, suite_ranking
from benchmark.settings.config import ConditionConfig
from benchmark.settings.scenes import TABLES
from benchmark.settings.setting import SettingError
from benchmark.settings.suite import suite_conditions, suite_task, suites

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


def ranking_lines(
    tables: "Mapping[str, pd.DataFrame]",
    suite: str,
    conditions: Mapping[str, ConditionConfig],
    ceilings: Mapping[str, Ceiling],
    task: "Task",
) -> list[str]:
    """One number for each method on a suite, as a table for people, and what has to be said of it.

    Args:
        tables: Rows of each condition (`by_condition`).
        suite: Its name.
        conditions: Its conditions.
        ceilings: Of these, frozen.
        task: What the rows are of.
    """
    pairs = method_pairs(tables, conditions, ceilings, task)
    if pairs.empty:
        return []
    counted = [name for name, condition in conditions.items() if not condition.saturated]
    ranking = suite_ranking(pairs, counted)
    return list(filter(None, [ranking_text(ranking), *remarks(ranking, suite, counted, ceilings)]))


def rankings(folder: Path, rows: "pd.DataFrame", task: "Task") -> dict[str, str]:
    """How methods rank on each suite of a task, by its name: Markdown of `ranking_lines`, of the scenes for tables.

    Args:
        folder: Ceilings are frozen in `suites/<suite>/ceilings.json` below it; suites without any are left out, and so
            are those of which all conditions are saturated.
        rows: Of episodes.
        task: What they are of.
    """
    rows, found = rows[rows.episode_seed.isin(TABLES)], {}
    for suite in (name for name in suites() if suite_task(name) == task.name):
        ceilings, conditions = read_ceilings(folder / "suites" / suite / "ceilings.json"), suite_conditions(suite)
        if ceilings and not all(condition.saturated for condition in conditions.values()):
            tables = by_condition(rows, suite_arms(conditions, task))
            found[suite] = "\n\n".join(ranking_lines(tables, suite, conditions, ceilings, task))
    return found


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
    tables = by_condition(rows, arms)
    if not any(map(len, tables.values())):
        raise SettingError(
            f"These are no episodes of the conditions of suite={suite}. Roll them out: "
            f"python -m benchmark.run suite={suite} method=..."
        )
    texts = ranking_lines(tables, suite, conditions, ceilings, task)
    print("\n\n".join([*texts, suite_text(suite_table(tables, conditions, ceilings, task), task)]))
