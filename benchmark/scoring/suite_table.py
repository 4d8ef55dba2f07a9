"""What methods come to on each condition of a suite, and all that is shown of one."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.episodes.arm import of_arm
from benchmark.scoring.ceiling import Ceiling, ceilings_file, read_ceilings
from benchmark.scoring.statistics import Crossed, clustered_mean
from benchmark.scoring.suite_ranking import REFERENCES, method_pairs, ranking_text, suite_ranking
from benchmark.settings.config import ConditionConfig, RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.scenes import TABLES
from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    import pandas as pd

    from envs.task import Task


def by_condition(
    rows: "pd.DataFrame", conditions: Mapping[str, ConditionConfig], task: "Task"
) -> "dict[str, pd.DataFrame]":
    """The rows of each condition of a suite, by its name."""
    from benchmark.episodes.arm import chosen_arm

    tables = {}
    for name, condition in conditions.items():
        settings = RunConfig(robot=RobotConfig(condition.robot), setting=condition.setting, arm=condition.arm)
        tables[name] = of_arm(rows, chosen_arm(settings, task))
    return tables


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
                (name, clustered_mean(_crossed(group, group[name]))),
                ("difference", clustered_difference(_crossed(pairs, less)) if len(pairs) else (np.nan,) * 3),
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


def _crossed(rows: "pd.DataFrame", values: "pd.Series") -> Crossed:
    """Values of these rows by training and episode."""
    return Crossed(values.to_numpy(float), rows.checkpoint_hash.to_numpy(str), rows.episode_seed.to_numpy())


def show_suite(
    suite: str, conditions: dict[str, ConditionConfig], rows: "pd.DataFrame", task: "Task", ceilings: Path | None = None
) -> None:
    """Print what rows come to on a suite, on one block of scenes: those for tables, or where none are, the others.

    Args:
        suite: Its name.
        conditions: Its conditions.
        rows: Of episodes.
        task: What they are of.
        ceilings: File of ceilings; None for those that are frozen with the suite.
    """
    in_block = rows.episode_seed.isin(TABLES)
    rows = rows[in_block] if in_block.any() else rows
    frozen, tables = read_ceilings(ceilings or ceilings_file(suite)), by_condition(rows, conditions, task)
    if not any(map(len, tables.values())):
        raise SettingError(
            f"These are no episodes of the conditions of suite={suite}. Roll them out: "
            f"python -m benchmark.run suite={suite} method=..."
        )
    counted = [name for name, condition in conditions.items() if not condition.saturated]
    texts, pairs = [], method_pairs(tables, conditions, frozen, task)
    if len(pairs):
        ranking = suite_ranking(pairs, counted)
        texts = [ranking_text(ranking), *remarks(ranking, suite, counted, frozen)]
    print("\n\n".join(filter(None, [*texts, suite_text(suite_table(tables, conditions, frozen, task), task)])))


def remarks(
    ranking: "pd.DataFrame", suite: str, counted: Sequence[str], ceilings: Mapping[str, Ceiling]
) -> "list[str]":
    """What there is to say of a ranking: why methods have no share or no rank, and which are tied."""
    methods = ranking[~ranking.method.isin(REFERENCES)]
    said: list[str] = []
    if methods.empty or not counted:
        return said
    if not {*counted} <= {*ceilings}:
        said.append(
            f"The ceilings of {suite} are not frozen, so there are no shares of head-room, and the mean gain ranks. To "
            f"freeze them: python -m benchmark.ceilings suite={suite}"
        )
    elif methods.share.isna().all():
        scenes = sorted({scene for each in ceilings.values() for scene in each.scenes})
        said.append(f"There are no shares of head-room: the ceilings are of scenes {scenes[0]} to {scenes[-1]} alone.")
    if len(lacking := [*methods.method[methods["rank"].isna()]]):
        said.append(f"Without a rank, as episodes of direct transfer's are missing: {', '.join(lacking)}.")
    if len(tied := [*methods.method[methods.tied.eq(True)]]):
        said.append(f"Even and odd scenes do not order the first alike: {', '.join(tied)} are tied.")
    return said
