"""One number for each method on a suite, the share of head-room that it closes, and what has to be known beside it."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.stats import trim_mean

from benchmark.scoring.ceiling import PLAIN, PLANNER, Ceiling
from benchmark.scoring.statistics import Crossed, clustered_difference, clustered_ratio
from benchmark.settings.chosen_scales import chosen_scales
from benchmark.settings.config import ConditionConfig, RunConfig, unfit
from benchmark.settings.task import chosen_task
from policies.methods import BY_TASK, DIRECT, METHODS, in_task

if TYPE_CHECKING:
    import pandas as pd

REFERENCES = (DIRECT, PLANNER, PLAIN)
"""What methods are compared with, and has no rank."""

FIRST = 3
"""So many of the first have to stand in the same order on even and on odd scenes, or are called tied."""

PAIR = ["checkpoint", "episode_seed"]


def method_pairs(
    tables: "Mapping[str, pd.DataFrame]",
    conditions: Mapping[str, ConditionConfig],
    ceilings: Mapping[str, Ceiling],
) -> "pd.DataFrame":
    """Each row of a method beside direct transfer's of the same policy and scene.

    Args:
        tables: Rows of each condition (`benchmark.scoring.suite_table.by_condition`).
        conditions: The suite's.
        ceilings: Of its conditions, frozen.

    Returns:
        `method`, `lambda`, `task`, `condition`, `saturated`, `checkpoint`, `episode_seed`, the `score` that ranks, the
        `gain` over direct transfer, and the `room` that the ceiling leaves above it, NaN where none is frozen for the
        scene; `whole`, whether the method has all rows that direct transfer has on this condition.
    """
    import pandas as pd

    parts = []
    for condition, rows in ((condition, rows) for condition, rows in tables.items() if len(rows)):
        task = conditions[condition].task
        name = chosen_task(task).ranking[0]
        few = rows[[*PAIR, "method", "lambda"]].assign(score=rows[name].astype(float))
        direct = few[few.method == DIRECT].set_index(PAIR).score.rename("direct")
        pairs = few.join(direct, on=PAIR, how="inner")
        of_ceiling = ceilings[condition].on(sorted({*pairs.episode_seed})) if condition in ceilings else None
        pairs["room"] = np.nan
        if of_ceiling:
            reached = pd.Series(of_ceiling.values, [of_ceiling.trainings, of_ceiling.episodes])
            pairs["room"] = reached.reindex(pd.MultiIndex.from_frame(pairs[PAIR])).to_numpy() - pairs.direct
        pairs["whole"] = pairs.groupby(["method", "lambda"]).score.transform("size") == len(direct)
        about = {"task": task, "condition": condition, "saturated": conditions[condition].saturated}
        parts.append(pairs.assign(**about, gain=pairs.score - pairs.direct))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def suite_ranking(pairs: "pd.DataFrame", counted: Sequence[str]) -> "pd.DataFrame":
    r"""A row for each method and scale, the best first; of several tasks a method has a scale for each, and every
    combination of those that there are is a row.

    `scales` has the scale by task, `lambda` is the same as a text. Where a method cannot act in a task, or was chosen
    not to, it counts as direct transfer there, and has no scale.

    `share` is :math:`\sum (s - s_0) / \sum (c - s_0)` over the counted conditions, with the method's score s, direct
    transfer's :math:`s_0` and the ceiling c, of the same policies on the same scenes; with its interval for other
    trainings and scenes. Above 1 a method does better than the ceiling, which is of what there was when it was frozen.
    Beside it: `middle`, the interquartile mean of the conditions' own shares (Agarwal et al., NeurIPS 2021); `gain`,
    the mean of the numerator with its interval; `worst`, the least gain on a counted condition, and `harm`, that on a
    saturated one, each with its condition, `worst_on` and `harm_on`; `better`, the chance that it does better than the
    next one (`probability_of_improvement`); `rank`, and whether it is `tied` with the others of the first three.

    A method that lacks rows of a counted condition has no figure of all of them, and no rank, as references have none.

    Args:
        pairs: As `method_pairs` gives them.
        counted: Conditions that are not saturated: on validation scenes the ceiling is 15 points or more above direct
            transfer.
    """
    import pandas as pd

    shown, of_ranked = [], {}
    for method, scales, group in _variants(pairs):
        of_room, scale = group[group.condition.isin(counted)], scales_text(scales, [*dict.fromkeys(pairs.task)])
        row = (
            {"method": method, "lambda": scale, "scales": scales}
            | _least(group[group.saturated], "harm")
            | _least(of_room, "worst")
        )
        share, middle, gain = (np.nan,) * 3, np.nan, (np.nan,) * 3
        if counted and {*of_room.condition} == {*counted} and of_room.whole.all():
            gain = clustered_difference(_crossed(of_room.groupby(PAIR).gain.mean()))
            if of_room.room.notna().all():
                sums = of_room.groupby(PAIR)[["gain", "room"]].sum()
                share = clustered_ratio(_crossed(sums.gain), _crossed(sums.room))
                by_condition = of_room.groupby("condition")[["gain", "room"]].sum()
                middle = interquartile_mean((by_condition.gain / by_condition.room.where(lambda x: x > 0)).to_numpy())
            if method not in REFERENCES:
                of_ranked[method, scale] = of_room
        for key, interval in (("share", share), ("gain", gain)):
            row |= dict(zip((key, f"{key}_low", f"{key}_high"), interval, strict=True))
        shown.append(row | {"middle": middle})
    table = pd.DataFrame(shown).sort_values("gain", ascending=False, ignore_index=True, kind="stable")
    return table.merge(_places(of_ranked), on=["method", "lambda"], how="left")


PARTS = {method for each in BY_TASK.values() for method in each.values()}
"""Methods that a rule is in one task or another."""


def _variants(pairs: "pd.DataFrame") -> "Iterator[tuple[str, dict[str, float], pd.DataFrame]]":
    """Each method with its scale by task, and its rows, with direct transfer's where it cannot act, or was chosen not
    to (scale 0)."""
    import pandas as pd

    tasks, direct = [*dict.fromkeys(pairs.task)], pairs[pairs.method == DIRECT]
    found = {str(method): rows for method, rows in pairs.groupby("method", sort=True)}
    if len(tasks) > 1:
        found |= {rule: _of_rule(pairs, rule) for rule in BY_TASK}
    for method, rows in found.items():
        if rows.empty:
            continue
        tried = {task: sorted({*of_task["lambda"]}) for task, of_task in rows.groupby("task", sort=False)}
        lacking = [task for task in tasks if task not in tried]
        idle = [task for task in lacking if _idle(in_task(method, task), task)]
        if method in PARTS and idle != lacking:
            continue  # It was rolled out as a part of a rule alone, which has a row of its own.
        beside = direct[direct.task.isin(idle)]
        for scales in (dict(zip(tried, each, strict=True)) for each in product(*tried.values())):
            chosen = rows[rows["lambda"] == rows.task.map(scales)]
            yield method, scales, pd.concat([chosen, beside], ignore_index=True) if len(beside) else chosen


def _of_rule(pairs: "pd.DataFrame", rule: str) -> "pd.DataFrame":
    """The rows of the methods that a rule is in each task; none where one of them has none."""
    methods = pairs.task.map(lambda task: in_task(rule, task))
    rows = pairs[pairs.method == methods]
    return rows if {*rows.task} == {*pairs.task} else rows[:0]


def _idle(method: str, task: str) -> bool:
    """Whether a method does nothing in a task: it cannot act there, or "off" did best on validation scenes."""
    chosen = chosen_scales(RunConfig.scales_dir, chosen_task(task).name).get(method)
    return bool(unfit(method, chosen_task(task))) or (chosen is not None and chosen["scale"] == 0)


def scales_text(scales: Mapping[str, float], tasks: Sequence[str]) -> str:
    """A method's scale, or its scales in the order of the tasks."""
    return ", ".join(f"{scales[task]:g}" if task in scales else "-" for task in tasks)


def interquartile_mean(values: Float[np.ndarray, " n"]) -> float:
    """Mean without the lowest and the highest quarter; what is no number is left out."""
    there = values[np.isfinite(values)]
    return float(trim_mean(there, 0.25)) if len(there) else np.nan


def probability_of_improvement(x: "pd.DataFrame", y: "pd.DataFrame") -> float:
    """Chance that a training does better with one method than a training does with another, mean over conditions.

    As rliable defines it (Agarwal et al., NeurIPS 2021): of each condition the Mann-Whitney statistic of the trainings'
    mean scores, divided by the number of pairs of trainings; equals count one half.

    Args:
        x: Rows of `method_pairs` of one method.
        y: Those of another, on the same conditions.
    """
    means = [rows.groupby(["condition", "checkpoint"]).score.mean() for rows in (x, y)]
    chances = []
    for condition in {*x.condition}:
        ones, others = (of.loc[condition].to_numpy() for of in means)
        differences = np.round(np.subtract.outer(ones, others), 12)
        chances.append((np.sign(differences) + 1).mean() / 2)
    return float(np.mean(chances))


def _places(ranked: "Mapping[tuple[str, str], pd.DataFrame]") -> "pd.DataFrame":
    """Rank of each, chance of being better than the next, and whether halves of the scenes disagree on the first."""
    import pandas as pd

    every, even, odd = (_order(ranked, halves) for halves in ((0, 1), (0,), (1,)))
    tied = even[:FIRST] != odd[:FIRST]
    rows = [
        {
            "method": method,
            "lambda": scale,
            "rank": place + 1,
            "tied": tied and place < FIRST,
            "even": even.index((method, scale)) + 1,
            "odd": odd.index((method, scale)) + 1,
            "better": probability_of_improvement(ranked[method, scale], ranked[every[place + 1]])
            if place + 1 < len(every)
            else np.nan,
        }
        for place, (method, scale) in enumerate(every)
    ]
    return pd.DataFrame(rows, columns=["method", "lambda", "rank", "tied", "even", "odd", "better"])


def _order(ranked: "Mapping[tuple[str, str], pd.DataFrame]", halves: tuple[int, ...]) -> list[tuple[str, str]]:
    """The methods by their gain on scenes whose seed is even (0) or odd (1), or either."""
    gains = {key: rows.gain[(rows.episode_seed % 2).isin(halves)].mean() for key, rows in ranked.items()}
    return sorted(gains, key=lambda key: -gains[key])


def _least(rows: "pd.DataFrame", name: str) -> dict[str, object]:
    """The least mean gain on a condition, and on which."""
    gains = rows.groupby("condition").gain.mean()
    return {name: gains.min(), f"{name}_on": gains.idxmin()} if len(gains) else {name: np.nan, f"{name}_on": ""}


def _crossed(values: "pd.Series") -> Crossed:
    """Values with the index `PAIR`."""
    checkpoints, seeds = (values.index.get_level_values(name) for name in PAIR)
    return Crossed(values.to_numpy(float), checkpoints.to_numpy(str), seeds.to_numpy())


def ranking_text(table: "pd.DataFrame") -> str:
    """The ranking for people, in Markdown; percent and points. Empty if there is nothing but references."""
    import pandas as pd

    from benchmark.scoring.scores import difference_text, with_interval

    table = table[~table.method.isin(REFERENCES)]
    first, lines = min(FIRST, int(table["rank"].notna().sum())), []
    for _, row in table.iterrows():
        rank = "-" if pd.isna(row["rank"]) else f"1 to {first}, tied" if row.tied else f"{row['rank']:.0f}"
        shares = ("-", "-") if pd.isna(row.share) else (with_interval(row, "share"), f"{100 * row.middle:.1f}")
        lines.append(
            {
                "rank": rank,
                "method": row.method,
                "λ": row["lambda"],
                "share of head-room closed": shares[0],
                "interquartile mean": shares[1],
                "mean gain": difference_text(row, "gain"),
                "worst condition": _on(row, "worst"),
                "largest loss where saturated": _on(row, "harm"),
                "better than the next": "-" if pd.isna(row.better) else f"{row.better:.2f}",
                "rank on even, odd scenes": "-" if pd.isna(row.even) else f"{row.even:.0f}, {row.odd:.0f}",
                "ms a step": "-" if pd.isna(time := row.get("step_ms", np.nan)) else f"{time:.1f}",
                "needs": needs_text(row.method),
            }
        )
    return pd.DataFrame(lines).to_markdown(index=False, disable_numparse=True) if lines else ""


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
            f"freeze them: python -m benchmark.studies.ceilings suite={suite}"
        )
    elif methods.share.isna().all():
        scenes = sorted({scene for each in ceilings.values() for scene in each.scenes})
        said.append(f"There are no shares of head-room: the ceilings are of scenes {scenes[0]} to {scenes[-1]} alone.")
    if len(lacking := [*methods.method[methods["rank"].isna()]]):
        said.append(f"Without a rank, as they lack episodes that direct transfer played: {', '.join(lacking)}.")
    if len(tied := [*methods.method[methods.tied.eq(True)]]):
        said.append(f"Even and odd scenes do not order the first alike: {', '.join(tied)} are tied.")
    return said


def needs_text(method: str) -> str:
    """What a method has to be given; a rule, what it has to be in one task or another."""
    methods = [METHODS[name] for name in BY_TASK.get(method, {"": method}).values() if name in METHODS]
    needs = dict.fromkeys(need for each in methods for need in each.needs)
    return (", ".join(needs) or "nothing") if methods else "not stated"


def _on(row: "pd.Series", name: str) -> str:
    return "-" if np.isnan(row[name]) else f"{100 * row[name]:+.1f} ({row[f'{name}_on']})"
