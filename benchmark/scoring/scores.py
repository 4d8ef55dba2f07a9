"""Scores of episodes: of what was run alike, with intervals, and paired with a control."""

from collections.abc import Mapping

import pandas as pd

from benchmark.episodes.episode import CONDITION
from benchmark.scoring.statistics import paired_difference, paired_p_value, rate_interval
from envs.task import Task

TOGETHER = [*CONDITION, "checkpoint", "cell_size"]
"""What episodes must share to be counted together; the last two follow from hashes, and are for people."""


def by_condition(episodes: pd.DataFrame, task: Task) -> pd.DataFrame:
    """One row per condition: n, each score with its 95 % interval, and failed episodes by cause; the best first.

    Args:
        episodes: The episodes table (`benchmark.episodes.table.Episode.row`).
        task: What they are of.
    """
    rows = []
    for condition, group in episodes.groupby(TOGETHER, dropna=False, sort=True):
        seeds = f"{group.episode_seed.min()}-{group.episode_seed.max()}"
        rows.append(dict(zip(TOGETHER, condition, strict=True)) | {"seeds": seeds} | figures(group, task))
    return pd.DataFrame(rows).sort_values(["setting", "robot", task.ranking[0]], ascending=[True, True, False])


def figures(episodes: pd.DataFrame, task: Task) -> dict:
    """Of episodes that belong together: n, each score with its 95 % interval (`_low`, `_high`), causes of failure."""
    row: dict = {"n": len(episodes)}
    for score in task.score_names:
        values = episodes[score].to_numpy(dtype=float)
        row[score] = float(values.mean())
        row[f"{score}_low"], row[f"{score}_high"] = rate_interval(values)
    return row | {"causes": episodes.failure_cause.dropna().value_counts().to_dict()}


def paired(episodes: pd.DataFrame, control: pd.DataFrame, task: Task) -> pd.DataFrame:
    """Difference of each score to a control on the episode seeds that both have; p-values by exact McNemar where it is
    yes or no."""
    pairs = episodes.merge(control, on="episode_seed", suffixes=("", "_control"))
    rows = []
    for score in task.score_names:
        a, b = pairs[score].to_numpy(dtype=float), pairs[f"{score}_control"].to_numpy(dtype=float)
        difference, low, high = paired_difference(a, b)
        p_value = paired_p_value(a, b) if task.is_yes_or_no(score) else None
        rows.append(
            {
                "score": score,
                "n": len(pairs),
                "difference": difference,
                "low": low,
                "high": high,
                "p": p_value,
            }
        )
    return pd.DataFrame(rows)


def with_interval(row: Mapping | pd.Series, name: str) -> str:
    """A score and its interval, in percent."""
    return f"{100 * row[name]:.1f} [{100 * row[f'{name}_low']:.1f}, {100 * row[f'{name}_high']:.1f}]"


def difference_text(row: pd.Series, name: str = "difference") -> str:
    """A difference and its interval, in points; - where there is none."""
    if pd.isna(row[name]):
        return "-"
    return f"{100 * row[name]:+.1f} [{100 * row[f'{name}_low']:+.1f}, {100 * row[f'{name}_high']:+.1f}]"


def causes_text(causes: dict[str, int]) -> str:
    """Number of failed episodes by cause, most frequent first."""
    return ", ".join(f"{cause} {count}" for cause, count in causes.items()) or "none"
