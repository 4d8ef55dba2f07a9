"""What the scripted oracles reach on an arm: the reference (plain) and the ceiling (aware) of its policies."""

import pandas as pd

from benchmark.config import ORACLE_METHODS
from benchmark.ranking import ARM
from benchmark.scores import SCORES
from benchmark.statistics import rate_interval

ROLES = {"reference": "plain", "ceiling": "aware"}


def with_oracles(table: pd.DataFrame, episodes: pd.DataFrame) -> pd.DataFrame:
    """A leaderboard with the columns `reference` and `ceiling`: n, first seed and scores, or None if not played.

    Args:
        table: The leaderboard.
        episodes: Rows of all methods. An oracle's arm must be the policy's in all columns that describe it, and the
            version of the code must be the same.
    """
    key = [*ARM, "code_version"]
    if "method" not in episodes:
        return table.assign(**dict.fromkeys(ROLES))
    return table.assign(
        **{
            role: [played.get(tuple(row)) for row in table[key].itertuples(index=False)]
            for role, oracle in ROLES.items()
            for played in [_scores(episodes[episodes.method == ORACLE_METHODS[oracle]].groupby(key))]
        }
    )


def _scores(groups) -> dict[tuple, dict[str, float]]:
    """n, first seed and scores with Wilson intervals of each group."""
    scores = {}
    for key, rows in groups:
        scores[key] = {"n": len(rows), "first": int(rows.episode_seed.min())}
        for name in SCORES:
            values = rows[name].to_numpy(dtype=float)
            low, high = rate_interval(values)
            scores[key] |= {name: float(values.mean()), f"{name}_low": low, f"{name}_high": high}
    return scores
