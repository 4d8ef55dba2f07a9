"""What methods come to on a suite: by condition, and the share of the head-room that each closes."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from benchmark.episodes.arm import of_arm
from benchmark.scoring.ceiling import PLAIN, PLANNER, Ceiling, ceilings_file, read_ceilings
from benchmark.scoring.statistics import Crossed, clustered_mean, clustered_ratio
from benchmark.settings.config import ConditionConfig, RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.scenes import TABLES

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


def shares(
    tables: "Mapping[str, pd.DataFrame]",
    conditions: Mapping[str, ConditionConfig],
    ceilings: Mapping[str, Ceiling],
    task: "Task",
) -> "pd.DataFrame":
    r"""Of each method the share of head-room that it closes, with its interval for other trainings and scenes.

    It is :math:`\sum (s - s_0) / \sum (c - s_0)` over the conditions that are not saturated, with the method's score s,
    direct transfer's :math:`s_0` and the ceiling c, of the same policies on the same scenes. Above 1 a method does
    better than the ceiling, which is of what there was when it was frozen. `harm` is the mean difference to direct
    transfer over the saturated ones. A method that lacks episodes of a condition has no share.
    """
    import pandas as pd

    name, counted = task.ranking[0], [key for key in tables if not conditions[key].saturated and key in ceilings]
    methods = sorted({(row.method, row["lambda"]) for rows in tables.values() for _, row in _methods(rows)})
    shown = []
    for method, scale in methods:
        parts, harm, whole = [], [], bool(counted)
        for condition, rows in tables.items():
            group = rows[(rows.method == method) & (rows["lambda"] == scale)]
            direct = rows[rows.method == "direct"]
            on = ["checkpoint", "episode_seed"]
            pairs = group[[*on, name]].merge(direct[[*on, name]], on=on, suffixes=("", "_direct"))
            pairs["gain"] = pairs[name].astype(float) - pairs[f"{name}_direct"].astype(float)
            if conditions[condition].saturated and len(pairs):
                harm.append(pairs.gain.mean())
            if condition not in counted:
                continue
            of_ceiling = ceilings[condition].on(sorted({*pairs.episode_seed}))
            reached = pd.DataFrame(
                {"checkpoint": of_ceiling.trainings, "episode_seed": of_ceiling.episodes, "reached": of_ceiling.values}
            )
            pairs = pairs.merge(reached, on=on)
            pairs["room"] = pairs.reached - pairs[f"{name}_direct"].astype(float)
            whole &= len(pairs) == len(direct) > 0
            parts.append(pairs[[*on, "gain", "room"]])
        row = {"method": method, "lambda": scale, "harm": np.mean(harm) if harm else np.nan}
        share = (np.nan,) * 3
        if whole:
            sums = pd.concat(parts).groupby(["checkpoint", "episode_seed"], as_index=False).sum()
            share = clustered_ratio(*(_by_policy(sums, sums[key]) for key in ("gain", "room")))
        shown.append(row | dict(zip(("share", "share_low", "share_high"), share, strict=True)))
    return pd.DataFrame(shown).sort_values("share", ascending=False, ignore_index=True)


def suite_text(table: "pd.DataFrame", shared: "pd.DataFrame", task: "Task") -> str:
    """Both tables for people, in Markdown; percent and points."""
    import pandas as pd

    from benchmark.scoring.scores import difference_text, with_interval

    name, blocks = task.ranking[0], []
    if shared.share.notna().any():
        lines = [
            {
                "method": row.method,
                "λ": f"{row['lambda']:g}",
                "share of head-room closed": with_interval(row, "share") if pd.notna(row.share) else "-",
                "harm where saturated": "-" if pd.isna(row.harm) else f"{100 * row.harm:+.1f}",
            }
            for _, row in shared.iterrows()
            if row.method not in ("direct", PLANNER, PLAIN)
        ]
        blocks.append(pd.DataFrame(lines).to_markdown(index=False, disable_numparse=True))
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
    blocks.append(pd.DataFrame(lines).to_markdown(index=False, disable_numparse=True))
    return "\n\n".join(blocks)


def _methods(rows: "pd.DataFrame") -> "list[tuple[int, pd.Series]]":
    return [*rows[["method", "lambda"]].drop_duplicates().iterrows()]


def _crossed(rows: "pd.DataFrame", values: "pd.Series") -> Crossed:
    """Values of these rows by training and episode."""
    return Crossed(values.to_numpy(float), rows.checkpoint_hash.to_numpy(str), rows.episode_seed.to_numpy())


def _by_policy(rows: "pd.DataFrame", values: "pd.Series") -> Crossed:
    return Crossed(values.to_numpy(float), rows.checkpoint.to_numpy(str), rows.episode_seed.to_numpy())


def show_suite(suite: str, conditions: dict[str, ConditionConfig], rows: "pd.DataFrame", task: "Task") -> None:
    """Print what rows come to on a suite, on one block of scenes: those for tables, or where none are, the others."""
    in_block = rows.episode_seed.isin(TABLES)
    rows = rows[in_block] if in_block.any() else rows
    ceilings, tables = read_ceilings(ceilings_file(suite)), by_condition(rows, conditions, task)
    shown = conditions, ceilings, task
    print(suite_text(suite_table(tables, *shown), shares(tables, *shown), task))
